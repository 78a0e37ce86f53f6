"""Integrators for Mitsuba 3: `import headtail.mitsuba` registers `headtail_direct` and `headtail_path` in
every variant with arrays.

Properties: `sampler` ("auto", "patches", "patches:fine", "mis2-comp", "mis2:portals", "mis2:portals:FILE" or "table",
built on first use), or `file` (a table of `headtail bake`, or a head of `headtail fit`, over patches or not, for the
scene's map); `hide_emitters`; of `headtail_direct` also `shading_samples`; of `headtail_path` also `max_depth` and
`rr_depth`. The scene has an environment map (`envmap`, with any rotation, or `constant`), and any other emitters.
"""

# _integrators.py: the integrators; _light.py: the environment and its sampler; _emitters.py: other emitters;
# _patches.py, _pairs.py, _portals.py, _table.py, _head.py: samplers; _rooms.py: portals of scenes; _pilot.py: the
# choice of `auto`; _network.py, _spline.py: parts of heads; _warp.py: directions and the quad-tree tail; _tails.py: the
# other tails; _surface.py: BSDFs as a diffuse and a Trowbridge-Reitz lobe.

import functools
import re

import drjit as dr
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
    if reason := _fault_of(variant):
        for name in ("headtail_direct", "headtail_path"):
            mi.register_integrator(name, _refuse(name, reason))
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
            if isinstance(error.__cause__, (HeadtailError, OSError)):
                raise error.__cause__ from None
            raise

    shown.shows_headtail_errors = True
    mi.render = shown


def _fault_of(variant):
    """Returns why a variant cannot run the integrators; None if it can."""
    if not variant.startswith(("llvm_", "cuda_")) or not variant.endswith(("_rgb", "_mono")):
        return f"the variant {variant} has no arrays of RGB colours or of grey; use llvm_ad_rgb, cuda_ad_rgb or their _mono"
    if variant.startswith("llvm_"):
        drjit, llvm = (tuple(map(int, re.findall(r"\d+", str(version))[:2])) for version in (dr.__version__, dr.detail.llvm_version()))
        # Dr.Jit's maximum is then an instruction that this LLVM lacks, and its failure ends the process.
        if drjit >= (1, 5) and llvm and 0 < llvm[0] < 16:
            return f"Mitsuba {mi.__version__} needs LLVM 16 or newer, and has found {llvm[0]}; name another by DRJIT_LIBLLVM_PATH, or use Mitsuba 3.9.0"
    return None


def _refuse(name, reason):
    def refuse(props):
        raise HeadtailError(f"{name}: {reason}")

    return refuse


def _variant_changed(old, new):
    register()


mi.detail.add_variant_callback(_variant_changed)
register()
