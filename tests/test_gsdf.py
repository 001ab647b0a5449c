"""DICOM's display function: compared with the standard's table, and films printed with it."""

from dataclasses import replace

import numpy as np
import pytest

from data_gen.render.composite import print_levels
from data_gen.sample import SampleConfig, densest_of, film_samples
from hybrid.coords import linear_from_srgb
from hybrid.gsdf import CLEAR_DENSITY, LAST_INDEX, LIGHT_BOX, ROOM, light_through, luminance
from hybrid.levels import MOST_ROOT_SHARE


def test_luminance_is_as_the_standards_table_has_it() -> None:
    told = luminance(np.array([1.0, 2.0, 3.0, LAST_INDEX]))
    np.testing.assert_allclose(told, [0.0500, 0.0547, 0.0594, 3993.404], rtol=1e-3)
    assert np.all(np.diff(luminance(np.linspace(1, LAST_INDEX, 500))) > 0)


@pytest.mark.parametrize("densest", [1.5, 3.0, 3.6])
def test_grey_runs_from_the_densest_film_to_clear_film_in_equal_steps(densest: float) -> None:
    grey = np.linspace(0, 1, 17)
    through = light_through(grey, densest)
    assert through[-1] == pytest.approx(1, rel=1e-3)
    assert through[0] == pytest.approx(10 ** (CLEAR_DENSITY - densest), rel=0.02)
    indices = np.linspace(1, LAST_INDEX, 20000)
    told = np.interp(ROOM + LIGHT_BOX * 10**-CLEAR_DENSITY * through, luminance(indices), indices)
    np.testing.assert_allclose(np.diff(told), np.diff(told).mean(), rtol=2e-3)


def test_such_films_are_darker_in_their_middle_greys() -> None:
    grey = np.tile(np.linspace(0, 1, 256, dtype=np.float32), (256, 1))
    display, film = (print_levels(grey, densest) for densest in (None, 3.0))
    middle = np.s_[:, 100:156]
    assert (film.reflectance[0][middle] < 0.75 * display.reflectance[0][middle]).all()
    np.testing.assert_array_equal(film.grey[0], display.grey[0])


def test_the_greatest_root_share_reaches_them() -> None:
    """A mix of straight line and square root, as used to recover films, turns their light back into grey; a print with
    a display's greys needs less of the root."""
    grey = np.linspace(0.02, 1, 200)
    shares = {}
    for name, light in (("film", light_through(grey, 3.0)), ("display", linear_from_srgb(grey))):
        errors = {}
        for share in np.arange(0, MOST_ROOT_SHARE + 0.01, 0.1):
            shown = share * np.sqrt(light) + (1 - share) * light
            slope, least = np.polyfit(shown, grey, 1)
            errors[share] = np.abs(slope * shown + least - grey).max()
        shares[name] = min(errors, key=errors.__getitem__)
        assert errors[shares[name]] < 0.04
    assert shares["display"] < 1.4 < shares["film"] < MOST_ROOT_SHARE


def test_some_films_are_printed_so_and_nothing_else_of_them_changes() -> None:
    config = SampleConfig(size=96, map_size=64, photos_per_film=1)
    drawn = [densest_of([5, number], config) for number in range(200)]
    assert np.mean([one is not None for one in drawn]) == pytest.approx(config.gsdf_share, abs=0.1)
    assert all(config.densities[0] <= one <= config.densities[1] for one in drawn if one is not None)
    (display,), (film,) = (film_samples(4, 2, replace(config, gsdf_share=share)) for share in (0.0, 1.0))
    assert display.parameters["densest"] is None
    assert film.parameters["densest"] == densest_of([4, 2], replace(config, gsdf_share=1.0))
    assert film.photo != display.photo
    np.testing.assert_array_equal(film.albedo, display.albedo)
    np.testing.assert_array_equal(film.maps.mask, display.maps.mask)
    assert film.parameters["light"] == display.parameters["light"]
