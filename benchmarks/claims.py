"""What a method says of its own result: its status, and the error that it expects and allows."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid.records import RectifyResult, StatusCode
from hybrid.rectify.verdict.trust import REFERENCE_PX


@dataclass(frozen=True)
class Claim:
    """What a method says of one result.

    status: name of a hybrid.records.StatusCode. expected_error_px: that it expects; limit_px: that a film with status
    OK may have at most; both of a photo of REFERENCE_PX, as end-point errors are, and None where it says none.
    """

    status: str
    expected_error_px: float | None = None
    limit_px: float | None = None

    @property
    def ok(self) -> bool:
        """Whether the film is called flattened."""
        return self.status == StatusCode.OK.name

    def broken_by(self, end_point_px: float) -> bool:
        """Whether the film is called flattened, but its error is larger than that allows."""
        return self.ok and self.limit_px is not None and end_point_px > self.limit_px


def claim_of(result: RectifyResult, photo_size: tuple[int, int]) -> Claim:
    """What a result says of itself; ``photo_size``: (h, w) of its photo."""
    to_reference = REFERENCE_PX / max(photo_size)
    expected, limit = (
        None if value is None else float(value) * to_reference for value in (result.expected_error_px, result.limit_px)
    )
    return Claim(result.status.code.name, expected, limit)


__all__ = ["Claim", "claim_of"]
