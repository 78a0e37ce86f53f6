"""Maps in Python: layouts, warnings, masked arrays, and "auto" with a scene."""

import numpy as np
import pytest

import headtail


def test_layouts_are_converted():
    column = np.full((48, 8, 3), 0.1, np.float32)
    # The third face of a column is up.
    column[16:24] = 1
    cube = headtail.Environment.from_array(column, layout="cube")
    assert cube.shape == (16, 32)
    up, down = cube.radiance(np.array([[0, 1, 0], [0, -1, 0]], np.float32))[:, 0]
    assert up == pytest.approx(1, rel=1e-3) and down == pytest.approx(0.1, rel=1e-3)
    with pytest.raises(headtail.HeadtailError, match="6 x 1 squares"):
        headtail.Environment.from_array(column[:, :, :].transpose(1, 0, 2)[:7], layout="cube")
    with pytest.raises(headtail.HeadtailError, match="equal-area"):
        headtail.Environment.from_array(column, layout="sphere")


def test_repairs_are_warned_of():
    texels = np.ones((2, 4, 3), np.float32)
    texels[0, 0, 0] = np.nan
    with pytest.warns(UserWarning, match="1 channel values were NaN"):
        environment = headtail.Environment.from_array(texels)
    assert environment.notes == [] and len(environment.warnings) == 1


def test_masked_elements_are_refused():
    texels = np.ma.masked_greater(np.ones((2, 4, 3), np.float32), 0.5)
    with pytest.raises(headtail.HeadtailError, match="masked array"):
        headtail.Environment.from_array(texels)
    # A mask without masked elements is accepted.
    whole = np.ma.array(np.ones((2, 4, 3), np.float32))
    assert headtail.Environment.from_array(whole).shape == (2, 4)


def test_auto_is_patches_without_a_scene_and_chosen_in_one(studio):
    n = np.array([[0, 1, 0]], np.float32)
    auto, patches = (headtail.Sampler.from_spec(spec, studio) for spec in ("auto", "patches"))
    assert (auto.sample(n, count=64, seed=1).wi == patches.sample(n, count=64, seed=1).wi).all()
    settings = {"env": studio, "spp": 256, "width": 64, "height": 48}
    chosen = headtail.render("sphere", **settings)
    assert chosen.sampler in ("split:4:patches+vis", "split:3:mis2-comp")
    again = headtail.render("sphere", chosen.sampler, **settings)
    assert (chosen.image == again.image).all() and again.sampler == chosen.sampler
