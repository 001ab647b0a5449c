"""How medical printers turn grey into density: DICOM's grayscale standard display function (PS3.14).

Equal steps of grey look equal on a light box, so middle greys let through less light than sRGB gives them: half grey 11
to 17 % of white's instead of 21 %.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

LIGHT_BOX, ROOM = 2000.0, 10.0
"""cd/m^2 of the light box, and of the room light that a film reflects, for which films are printed (PS3.14,
annex C)."""

CLEAR_DENSITY = 0.2
"""Optical density of a film where print is white."""

USUAL_DENSITIES = (2.0, 3.4)
"""Least and greatest optical density of print black, depending on the printer and its film."""

_ABOVE = (-1.3011877, 8.0242636e-2, 1.3646699e-1, -2.5468404e-2, 1.3635334e-3)
_BELOW = (1.0, -2.5840191e-2, -1.0320229e-1, 2.8745620e-2, -3.1978977e-3, 1.2992634e-4)
"""Coefficients, by powers of an index's logarithm, of equation (1) of PS3.14."""

LAST_INDEX = 1023


def luminance(index: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """cd/m^2 of just-noticeable differences 1 to ``LAST_INDEX`` (PS3.14, equation (1))."""
    logs = np.log(index)
    return 10 ** (np.polynomial.polynomial.polyval(logs, _ABOVE) / np.polynomial.polynomial.polyval(logs, _BELOW))


def light_through(grey: Float[np.ndarray, "*n"], densest: float) -> Float[np.ndarray, "*n"]:
    """Light that a film lets through, linear, as a fraction of what it lets through where print is white.

    grey: display grey in [0, 1], as sent to the printer (P-values). densest: optical density of print black, above
    ``CLEAR_DENSITY``.
    """
    indices = np.linspace(1, LAST_INDEX, 8 * LAST_INDEX)
    ends = [ROOM + LIGHT_BOX * 10**-density for density in (densest, CLEAR_DENSITY)]
    first, last = np.interp(ends, luminance(indices), indices)
    through = (luminance(first + grey * (last - first)) - ROOM) / LIGHT_BOX
    return through * 10**CLEAR_DENSITY
