"""Integrators for Mitsuba 3: `import headtail.mitsuba` registers `headtail_direct` and `headtail_path` in
every variant with arrays.

Properties: `sampler` ("auto", which is "patches", "patches:fine" or "table", built on first use), or `file` (a table
of `headtail bake`, or a head of `headtail fit`, over patches or not, for the scene's map); `hide_emitters`; of
`headtail_direct` also `shading_samples`; of `headtail_path` also `max_depth` and `rr_depth`. The scene has an environment
map (`envmap`, with any rotation, or `constant`), and any other emitters.
"""

# _integrators.py: the integrators; _light.py: the environment and its sampler; _emitters.py: other emitters;
# _patches.py, _table.py, _head.py: samplers; _network.py, _spline.py: parts of heads; _warp.py: directions and
# the quad-tree tail; _tails.py: the other tails; _surface.py: BSDFs as a diffuse and a Trowbridge-Reitz lobe.

import functools

import mitsuba as mi

from headtail import HeadtailError

_registered = set()


def register():
    """Registers the integrators in the current variant; `import` calls it, as does every later
    `mitsuba.set_variant`."""
    variant = mi.variant()
    if variant is None or variant in _registered:
        return
    _registered.add(variant)
    if not variant.startswith(("llvm_", "cuda_")) or not variant.endswith(("_rgb", "_mono")):
        for name in ("headtail_direct", "headtail_path"):
            mi.register_integrator(name, _refuse(name, variant))
        return
    _show_causes()
    from ._integrators import make

    for name, integrator in make().items():
        mi.register_integrator(name, integrator)


def _show_causes():
    """Makes `mitsuba.render` raise an integrator's own error instead of Dr.Jit's wrapper of it."""
    render = mi.render
    if hasattr(render, "shows_headtail_errors"):
        return

    @functools.wraps(render)
    def shown(*arguments, **settings):
        try:
            return render(*arguments, **settings)
        except RuntimeError as error:
            if isinstance(error.__cause__, HeadtailError):
                raise error.__cause__ from None
            raise

    shown.shows_headtail_errors = True
    mi.render = shown


def _refuse(name, variant):
    def refuse(props):
        raise HeadtailError(f"{name}: the variant {variant} has no arrays of RGB colours or of grey; use llvm_ad_rgb, cuda_ad_rgb or their _mono")

    return refuse


def _variant_changed(old, new):
    register()


mi.detail.add_variant_callback(_variant_changed)
register()
