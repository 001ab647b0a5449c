"""Hands and clips: coverage is a share, nothing floats, pixels free of them are unchanged, radiance follows light."""

import json

import cv2
import numpy as np
import pytest
from surroundings_case import FILM, SIZE, camera, even_room, scene

from data_gen.light.lamps import Lamp
from data_gen.light.lighting import Light
from data_gen.light.lit_sphere import ball_normals, lit_sphere, look_up, with_lamps
from data_gen.light.rooms import prefilter, procedural_room
from data_gen.render.surroundings import surroundings
from data_gen.scene.clips import HIDING_OPACITY, KINDS, Clip, sample_clips
from data_gen.scene.hand_model import GRIPS, VARIANTS, hand_model
from data_gen.scene.hands import Hand, sample_hands, skin_reflectance
from data_gen.scene.patches import Patch, blurred, hidden_share, put_over, shading_only
from data_gen.scene.relief import MIDDLE, coded_shape, decoded_normals
from data_gen.scene.scene import SceneConfig, sample_scene
from data_gen.scene.shadows import KINDS as SHADOWS
from data_gen.scene.shadows import Shadow, film_shadow, sample_shadows
from data_gen.scene.things import patches_before, patches_behind, rim_place, sample_things
from hybrid.coords import centres_1d

LIGHT = Light(front=1.0, turn_deg=0.0, lying=False)
SKIN, CLOTH = (0.4, 0.25, 0.18), (0.1, 0.1, 0.12)


def balls(radiance=1.0):
    room = even_room(radiance)
    return lit_sphere(LIGHT, room, np.eye(3), 0.4, 0.03), lit_sphere(LIGHT, room, np.eye(3), 0.2, 0.6)


def hand(grip, variant=0, edge=2.5, mirrored=False) -> Hand:
    return Hand(grip, variant, edge, 5.0, mirrored, 1.0, SKIN, CLOTH, None)


def clip(kind, opacity=1.0) -> Clip:
    return Clip(kind, 0.4, 3.0, 30.0, 12.0, (0.3, 0.3, 0.3), 0.5, opacity)


THINGS = [hand(g, v, mirrored=bool(v % 2)) for g in GRIPS for v in (0, 1)] + [clip(k) for k in KINDS]


@pytest.mark.parametrize("thing", THINGS, ids=lambda t: getattr(t, "grip", None) or t.kind)
def test_patches_are_shares_within_the_photo(thing):
    view = camera(tilt=0.2)
    patches = patches_before((thing,), FILM, view, *balls()) + patches_behind((thing,), FILM, view, balls()[0])
    assert patches
    for patch in patches:
        rows, cols = patch.box
        assert 0 <= rows.start < rows.stop <= SIZE[0]
        assert 0 <= cols.start < cols.stop <= SIZE[1]
        for share in (patch.cover, patch.hides, patch.shade):
            assert share.shape == (rows.stop - rows.start, cols.stop - cols.start)
            assert share.min() >= 0
            assert share.max() <= 1
        assert (patch.hides <= patch.cover).all()
        assert patch.shade.min() > 0
        assert np.isfinite(patch.radiance).all()
        assert patch.radiance.min() >= 0


@pytest.mark.parametrize("grip", GRIPS)
def test_arms_leave_the_photo(grip):
    """A hand covers some pixel of the photo's border: nothing ends in mid-air."""
    view = camera(distance_mm=1100.0)
    for edge in (0.5, 1.5, 2.5, 3.5):
        held = hand(grip, 1, edge)
        patches = patches_behind((held,), FILM, view, balls()[0]) or patches_before((held,), FILM, view, *balls())
        cover = hidden_share(patches, SIZE)
        border = np.concatenate([cover[0], cover[-1], cover[:, 0], cover[:, -1]])
        assert border.max() > 0.9


@pytest.mark.parametrize("corner", range(4))
def test_near_a_corner_holders_reach_towards_the_middle(corner):
    """On both sides of each corner, seen from the front: just beside it, nearly along the diagonal."""
    view = camera((600, 750), 900.0)
    middle = view.photo_from_world(FILM.vertices.reshape(-1, 3).mean(axis=0)[None])[0]
    for edge in (corner - 0.02, corner + 0.02):
        place = rim_place(FILM, view, edge % 4)
        to_middle = (middle - place.at) / np.linalg.norm(middle - place.at)
        assert place.inward @ to_middle > 0.85


def test_a_finger_is_as_wide_as_a_finger():
    """13 to 23 mm at the median across the last joint of a pointing finger, by the scale of the camera."""
    view = camera((600, 750), 700.0)
    place = rim_place(FILM, view, 3.5)
    patch = patches_before((hand("point"),), FILM, view, *balls())[0]
    widths = []
    for seed in range(VARIANTS):
        patch = patches_before((hand("point", seed, 3.5),), FILM, view, *balls())[0]
        cover = np.zeros(view.size)
        cover[patch.box] = patch.cover
        inside = place.at + 4 * place.px_per_mm * place.inward
        column = cover[:, round(float(inside[0]))]
        widths.append(column.sum() / place.px_per_mm)
    assert 13 < np.median(widths) < 23


def test_pixels_without_things_stay_as_they_were():
    view = camera()
    picture = np.random.default_rng(0).random((*SIZE, 3)).astype(np.float32)
    before = picture.copy()
    patches = patches_before((hand("pinch"), clip("bulldog")), FILM, view, *balls())
    out = put_over(picture, patches)
    np.testing.assert_array_equal(picture, before)  # inputs are not modified
    touched = np.zeros(SIZE, bool)
    for patch in patches:
        touched[patch.box] |= (patch.cover > 0) | (patch.shade < 1)
    np.testing.assert_array_equal(out[~touched], picture[~touched])
    assert (out[touched] != picture[touched]).any()


def test_full_cover_replaces_and_no_cover_keeps():
    box = (slice(2, 5), slice(3, 7))
    ones = np.ones((3, 4), np.float32)
    red = np.broadcast_to(np.array([1.0, 0, 0], np.float32), (3, 4, 3))
    picture = np.full((8, 9, 3), 0.5, np.float32)
    assert (put_over(picture, [Patch(box, red, ones, ones, ones)])[box] == red).all()
    assert (put_over(picture, [Patch(box, red, 0 * ones, 0 * ones, ones)]) == picture).all()
    assert hidden_share([Patch(box, red, ones, 0 * ones, ones)], (8, 9)).max() == 0


def test_what_is_far_behind_is_not_shaded_by_what_holds_the_film():
    box = (slice(2, 5), slice(3, 7))
    nothing = np.zeros((3, 4), np.float32)
    patch = Patch(box, np.zeros((3, 4, 3), np.float32), nothing, nothing, nothing + np.float32(0.4))
    picture, film = np.ones((8, 9, 3), np.float32), np.zeros((8, 9), np.float32)
    film[:, :5] = 1
    out = put_over(picture, [shading_only(patch, film)])
    np.testing.assert_allclose(out[2:5, 3:5], 0.4)
    np.testing.assert_array_equal(out[2:5, 5:7], 1)


def test_a_wide_blur_is_that_of_the_full_picture():
    mask = np.zeros((160, 200), np.float32)
    mask[40:110, 50:140] = 1
    np.testing.assert_allclose(blurred(mask, 15.0), cv2.GaussianBlur(mask, (0, 0), 15.0), atol=0.03)


def test_thin_tape_leaves_the_print_readable_and_thick_tape_hides_it():
    view = camera((240, 300))
    for opacity, hides in ((HIDING_OPACITY - 0.1, False), (HIDING_OPACITY + 0.1, True)):
        patches = patches_before((clip("tape", opacity),), FILM, view, *balls())
        assert patches[0].cover.max() == pytest.approx(opacity, abs=1e-6)
        assert (hidden_share(patches, view.size).max() > HIDING_OPACITY) == hides


def test_radiance_of_things_scales_with_the_light():
    view, things = camera(), (hand("fist"), clip("magnet"))
    once, thrice = (patches_before(things, FILM, view, *balls(level)) for level in (1.0, 3.0))
    for a, b in zip(once, thrice, strict=True):
        np.testing.assert_allclose(3 * a.radiance, b.radiance, rtol=1e-4, atol=1e-5)


def test_a_matt_ball_in_even_light_is_as_bright_as_the_light():
    ball, _ = balls(0.8)
    np.testing.assert_allclose(ball.matt, 0.8, rtol=1e-3)
    np.testing.assert_allclose(look_up(ball.matt, np.zeros((2, 2, 2), np.float32)), 0.8, rtol=1e-3)
    assert ball.gloss.max() <= 0.8 * 1.001  # a mirror is no brighter than what it shows


def test_a_lit_ball_is_bright_on_the_side_of_the_light():
    rng = np.random.default_rng(1)
    room = prefilter(procedural_room(rng, (64, 128)))
    turned = lit_sphere(LIGHT, room, np.diag([-1.0, -1.0, 1.0]), 0.4, 0.03)
    straight = lit_sphere(LIGHT, room, np.eye(3), 0.4, 0.03)
    inside = np.linalg.norm(ball_normals()[..., :2], axis=-1) < 0.98
    np.testing.assert_allclose(turned.matt[::-1, ::-1][inside], straight.matt[inside], rtol=1e-4)


def test_a_small_lamp_lights_the_ball_by_the_cosine():
    """Lambert: irradiance of a far sphere is pi sin^2 times the cosine; nothing on the side turned away."""
    lamp = Lamp("sphere", (0.0, -3000.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (30.0, 30.0), (1e4, 1e4, 1e4))
    dark, _ = balls(1e-6)
    lit = with_lamps(dark, [lamp], np.eye(3)).matt[..., 1]
    expected = 1e4 * (30 / 3000) ** 2 * np.maximum(-ball_normals()[..., 1], 0)
    np.testing.assert_allclose(lit, expected, atol=0.012)


def test_a_dome_has_the_normals_of_a_sphere():
    mm = 20.0
    x, y = np.meshgrid(centres_1d(160) / 4 - mm, centres_1d(160) / 4 - mm)
    radius = np.hypot(x, y)
    height = np.sqrt(np.maximum(25.0**2 - radius**2, 0)).astype(np.float32)
    shape = coded_shape(height, (15 - radius).astype(np.float32), 4.0)
    normal = decoded_normals(shape, np.array([[1.0, 0, 0], [0, 1.0, 0]]))
    inside = radius < 14
    np.testing.assert_allclose(normal[inside], np.stack([x, y], axis=-1)[inside] / 25.0, atol=0.012)
    assert ((shape[..., 3] > MIDDLE) == (radius < 15))[np.abs(radius - 15) > 0.2].all()


@pytest.mark.parametrize("grip", GRIPS)
@pytest.mark.parametrize("variant", range(VARIANTS))
def test_all_of_a_hand_is_before_the_film_or_behind_it(grip, variant):
    """What is in neither picture would be missing, cut off along a joint: the thumb once was."""
    model = hand_model(grip, variant)
    before, whole = model.skin[..., 0] > MIDDLE, model.shape[..., 3] > MIDDLE
    assert hand(grip).behind or (before == whole).mean() > 0.995


@pytest.mark.parametrize("grip", GRIPS)
def test_an_arm_that_goes_on_beyond_its_picture_has_no_stripes(grip):
    """Its first column is repeated: a spot there would be drawn out along the arm."""
    for variant in range(VARIANTS):
        assert np.abs(hand_model(grip, variant).skin[:, 0, 1].astype(int) - 128).max() <= 1


def test_models_are_drawn_once_and_alike():
    first = hand_model("pinch", 2)
    assert hand_model("pinch", 2) is first
    again = hand_model.__wrapped__("pinch", 2)
    np.testing.assert_array_equal(again.shape, first.shape)
    np.testing.assert_array_equal(again.skin, first.skin)


def test_skin_covers_the_human_range_and_reflects_red_most():
    rng = np.random.default_rng(0)
    tones = np.array([skin_reflectance(t, rng) for t in np.linspace(0, 1, 30)])
    assert tones.max() < 0.9
    assert tones[0].mean() > 6 * tones[-1].mean()
    assert (tones[:, 0] > 0.9 * tones[:, 2]).all()


def test_nobody_reaches_behind_a_film_that_lies_on_something():
    rng = np.random.default_rng(0)
    for _ in range(60):
        assert not any(h.behind for h in sample_hands(2, True, rng))


def test_nobody_reaches_behind_a_film_on_a_light_box():
    for seed in range(60):
        drawn = sample_scene(FILM, SIZE, np.random.default_rng(seed), SceneConfig(light_box_share=1.0, thing_share=1.0))
        assert not any(isinstance(thing, Hand) and thing.behind for thing in drawn.things)


def test_holders_are_of_every_kind():
    rng = np.random.default_rng(0)
    assert {c.kind for _ in range(120) for c in sample_clips(2, rng)} == set(KINDS)
    assert {type(t) for _ in range(30) for t in sample_things(False, rng)} == {Hand, Clip}


def test_parameters_of_a_scene_are_json():
    rng = np.random.default_rng(5)
    for _ in range(25):
        drawn = sample_scene(FILM, SIZE, rng, SceneConfig(thing_share=1.0))
        text = json.dumps(drawn.parameters())
        assert json.loads(text)["things"]


def test_surroundings_are_the_same_twice():
    room, base = even_room(), np.full(3, 0.02)
    photographed = scene("wall", 2, held=(hand("pinch"), clip("foldback")), gap_mm=200.0)
    first, again = (surroundings(photographed, FILM, room, base) for _ in range(2))
    np.testing.assert_array_equal(first.behind, again.behind)
    for a, b in zip(first.before, again.before, strict=True):
        np.testing.assert_array_equal(a.radiance, b.radiance)
        np.testing.assert_array_equal(a.cover, b.cover)


# ---------------------------------------------------------------- shadows


def shadow(kind="hand", penumbra_mm=2.0, depth=0.6) -> Shadow:
    return Shadow(kind, (0.5, 0.5), -80.0, 1.1, penumbra_mm, depth, 1)


@pytest.mark.parametrize("kind", SHADOWS)
def test_shadows_only_take_light_and_never_all(kind):
    factor = film_shadow((shadow(kind),), (430.0, 350.0), 64)
    assert factor.shape == (64, 64)
    assert factor.min() == pytest.approx(1 - 0.6, abs=0.05)
    assert factor.max() <= 1


def test_no_shadow_takes_no_light():
    assert (film_shadow((), (430.0, 350.0), 16) == 1).all()


def test_two_shadows_take_light_one_after_the_other():
    one, other = shadow("hand"), shadow("edge")
    size = (430.0, 350.0)
    both = film_shadow((one, other), size, 48)
    np.testing.assert_allclose(both, film_shadow((one,), size, 48) * film_shadow((other,), size, 48), rtol=1e-6)


def test_the_penumbra_widens_the_rim_and_keeps_the_middle():
    """Across an edge the factor is that of a blurred step: half the depth on the line, 16 % one sigma beyond it.

    To within the change over one step of the lattice.
    """
    for penumbra in (20.0, 40.0):
        edge = Shadow("edge", (0.5, 0.5), 0.0, 1.0, penumbra, 0.8, 0)
        column = film_shadow((edge,), (400.0, 400.0), 200)[:, 100]
        mm = 400 * (centres_1d(200) / 200 - np.array(1 / 2))
        for at, share in ((0.0, 0.5), (penumbra, 0.1587), (-penumbra, 0.8413)):
            assert np.interp(at, mm, column) == pytest.approx(1 - 0.8 * share, abs=0.04)


def test_a_shadow_of_life_size_is_as_large_as_the_phone():
    factor = film_shadow((Shadow("phone", (0.2, 0.5), 0.0, 1.0, 0.5, 0.5, 0),), (400.0, 400.0), 200)
    dark = factor[:, round(0.5 * 200)] < 0.75
    assert dark.sum() * 2 == pytest.approx(76, abs=8)


def test_drawn_shadows_repeat_with_their_seed():
    first, again = (sample_shadows(np.random.default_rng(7)) for _ in range(2))
    assert first == again
