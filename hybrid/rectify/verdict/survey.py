"""A cheap look at a photo and at what the network made of it: what is there, and which stages are needed.

Every decision carries one line of evidence, which the user sees in the stage reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, inside_outline, photo_from_opencv
from hybrid.errors import require_at_least, require_at_most
from hybrid.pyramid import Pyramid
from hybrid.records import CoarseMaps, StatusCode
from hybrid.rectify.coarse.invert import Inversion, NotInverted
from hybrid.rectify.film.resample import index_in_grid, rectify_photo

PRINT_PX, PRINT_DETAIL_PX = 320, 12.0
"""Side of the flat copy on which the print is looked at, and the scale below which brightness is print, not light."""


@dataclass(frozen=True)
class SurveyConfig:
    """When a photo holds a film, and when a stage is not needed."""

    min_side_px: int = 64
    """Photos with a shorter side are refused."""
    blank_spread: float = 4.0
    """A photo whose grey levels (0 to 255) hardly ever leave a band this wide counts as being of one colour."""
    min_mask_share: float = 0.03
    """Least share of the network's crop that shows film."""
    min_inlier_share: float = 0.7
    """Least share of the film pixels that one smooth shape explains."""
    max_residual: float = 0.03
    """Largest residual of that shape, as a part of the film's size in the photo."""
    min_coverage: float = 0.45
    """Least share of the sheet that is seen."""
    min_overlap: float = 0.825
    """Least intersection over union of the mask with the outline of the flattened film."""
    max_expected_error: float = 0.0145
    """Largest median error that the network expects of film coordinates; it is unsure about what is no film."""
    min_skewness: float = -0.7
    """Least skewness of the print's fine detail. A film is dark with bright texts and bones (-0.3 to 4 on photos with
    truth), a sheet of paper bright with dark type (-3.5 to -1.1 on photographed invoices)."""
    max_stretch: float = 60.0
    """Largest ratio of the areas that equal pieces of the film cover in the photo."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "max_stretch")
        require_at_most(self, 1, "min_mask_share", "min_inlier_share", "min_coverage", "min_overlap")


@dataclass(frozen=True)
class Verdict:
    """Whether a photo can be worked on: OK or the status that ends the work, the evidence, and the doubts."""

    code: StatusCode
    reason: str
    doubts: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        return self.code is StatusCode.OK


def survey_photo(photo: UInt8[np.ndarray, "H W 3"], config: SurveyConfig | None = None) -> Verdict:
    """Whether the photo is large enough and shows anything at all."""
    config = config or SurveyConfig()
    height, width = photo.shape[:2]
    if min(height, width) < config.min_side_px:
        return Verdict(StatusCode.TOO_SMALL, f"{width} x {height} pixels; {config.min_side_px} a side are needed")
    spread = grey_spread(photo)
    if spread < config.blank_spread:
        return Verdict(StatusCode.BLANK, f"99 % of the pixels lie within {spread:.0f} of 255 grey levels")
    return Verdict(StatusCode.OK, f"{width} x {height} pixels over {spread:.0f} of 255 grey levels")


def survey_maps(
    maps: CoarseMaps, inversion: Inversion | NotInverted, size: Sequence[int], config: SurveyConfig | None = None
) -> Verdict:
    """Whether what the network saw is a film: one sheet, seen once, most of it, with an outline that fits the mask.

    size: height and width of the photo: a film whose outline fits the mask only within the photo is cut off.
    """
    config = config or SurveyConfig()
    if isinstance(inversion, NotInverted):
        return Verdict(StatusCode.NO_FILM, inversion.reason)
    share = float(np.mean(maps.film))
    film_px = float(np.sqrt(np.prod(inversion.backward.mean_film_pixels())))
    residual = inversion.residual_px / max(film_px, 1e-9)
    overlap = mask_overlap(maps, inversion.backward)
    unsure = expected_error(maps)
    evidence = (
        f"film on {share:.0%} of the picture, {inversion.coverage:.0%} of the sheet seen, one shape fits "
        f"{inversion.inlier_share:.0%} of it to {residual:.1%} of its size, outline and mask agree to {overlap:.0%}, "
        f"{unsure:.1%} error expected"
    )
    if (
        share < config.min_mask_share
        or inversion.inlier_share < config.min_inlier_share
        or residual > config.max_residual
        or inversion.coverage < config.min_coverage
        or unsure > config.max_expected_error
    ):
        return Verdict(StatusCode.NO_FILM, evidence)
    if overlap < config.min_overlap:
        within = mask_overlap(maps, inversion.backward, size)
        code = StatusCode.NO_FILM if within < config.min_overlap else StatusCode.CUT_OFF
        return Verdict(code, f"{evidence}, {within:.0%} within the photo")
    return _shape_verdict(inversion.backward, evidence, config)


def grey_spread(photo: UInt8[np.ndarray, "H W 3"]) -> float:
    """How many grey levels (0 to 255) a photo puts to use: the range of 99 % of its pixels, in the colour with the
    largest range."""
    step = max(min(photo.shape[:2]) // 256, 1)
    low, high = np.percentile(photo[::step, ::step], [0.5, 99.5], axis=(0, 1))
    return float((high - low).max())


def survey_print(
    photo: UInt8[np.ndarray, "H W 3"] | Pyramid, backward: BackwardMap, config: SurveyConfig | None = None
) -> Verdict:
    """Whether the sheet is printed bright on dark, as films are, and not dark on bright, as paper is."""
    config = config or SurveyConfig()
    flat = rectify_photo(photo, backward, (PRINT_PX, PRINT_PX))
    grey = cv2.cvtColor(flat.image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    detail = (grey - cv2.GaussianBlur(grey, (0, 0), PRINT_DETAIL_PX))[flat.valid]
    spread = float(detail.std()) if detail.size else 0.0
    if spread < 0.5:  # grey levels: rounding alone gives as much
        return Verdict(StatusCode.OK, "nothing printed is seen")
    share = np.clip(detail / spread, -4.0, 4.0)
    skewness = float(np.mean(share * share * share))  # a general power takes ten times as long
    if skewness < config.min_skewness:
        return Verdict(StatusCode.PAPER, f"dark type on a bright sheet (skewness {skewness:.1f}): paper, not film")
    return Verdict(StatusCode.OK, f"bright print on a dark sheet (skewness {skewness:.1f})")


def expected_error(maps: CoarseMaps) -> float:
    """Median error that the network expects of its film coordinates; 0 where it states none."""
    film = maps.film
    return float(np.median(maps.expected_error[film])) if maps.expected_error is not None and film.any() else 0.0


def _shape_verdict(backward: BackwardMap, evidence: str, config: SurveyConfig) -> Verdict:
    """OK where the map neither folds nor crushes any part of the sheet."""
    area = np.abs(np.linalg.det(backward.jacobian(film_nodes((17, 17)))))
    if backward.folds((17, 17)):
        return Verdict(StatusCode.FOLDED, f"the map turns over; {evidence}")
    stretch = float(area.max() / area.min())
    if stretch > config.max_stretch:
        return Verdict(StatusCode.FOLDED, f"equal pieces of film differ {stretch:.0f} times in area; {evidence}")
    return Verdict(StatusCode.OK, evidence)


def mask_overlap(maps: CoarseMaps, backward: BackwardMap, size: Sequence[int] | None = None) -> float:
    """Intersection over union of the mask with the film's outline, within the picture that the network saw.

    size: height and width of the photo, if only what lies within it counts.
    """
    mask: Bool[np.ndarray, "h w"] = maps.film
    outline = np.stack(index_in_grid(maps.photo_points, backward.outline()), axis=-1)
    inside = inside_outline(photo_from_opencv(outline), (mask.shape[0], mask.shape[1]))
    if size is not None:
        reached = _reached(maps, size)
        mask, inside = mask & reached, inside & reached
    union = np.count_nonzero(mask | inside)
    return np.count_nonzero(mask & inside) / union if union else 0.0


def film_share(maps: CoarseMaps, size: Sequence[int]) -> float:
    """Share of a photo of ``size`` (height, width) that shows film, as far as the network saw it."""
    reached = _reached(maps, size)
    return float(maps.film[reached].mean()) if reached.any() else 0.0


def _reached(maps: CoarseMaps, size: Sequence[int]) -> Bool[np.ndarray, "h w"]:
    """Which pixels of the maps lie within a photo of ``size``."""
    return np.all((maps.photo_points >= 0) & (maps.photo_points <= (size[1], size[0])), axis=-1)
