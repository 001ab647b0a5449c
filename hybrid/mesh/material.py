"""What a film is made of, in the units of the data sheet: MPa, mm, kg/mm^3."""

from __future__ import annotations

from dataclasses import dataclass

STANDARD_GRAVITY = 9.80665
"""m/s^2."""


@dataclass(frozen=True)
class FilmMaterial:
    """Elastic film. The defaults are the PET base of an X-ray film.

    youngs_modulus_mpa: N/mm^2. thickness_mm: mm. poisson: Poisson's ratio. density_kg_mm3: kg/mm^3.
    membrane_scale: factor on the stretching stiffness only; below 1 the sheet behaves like the soft bodies of the
        published data set, which bulge into shapes that no real sheet can take.
    """

    youngs_modulus_mpa: float = 4000.0
    thickness_mm: float = 0.175
    poisson: float = 0.3
    density_kg_mm3: float = 1390e-9
    membrane_scale: float = 1.0

    @property
    def bending_stiffness(self) -> float:
        """D = E h^3 / (12 (1 - nu^2)) in N mm."""
        return self.youngs_modulus_mpa * self.thickness_mm**3 / (12 * (1 - self.poisson**2))

    @property
    def membrane_stiffness(self) -> float:
        """E h in N/mm, scaled."""
        return self.youngs_modulus_mpa * self.thickness_mm * self.membrane_scale
