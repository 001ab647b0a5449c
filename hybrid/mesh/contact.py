"""Bodies that a film rests on or is touched by: signed distance, contact as a spring on the depth, friction.

Contact acts on vertices. Its Hessian leaves out the curvature of the body's surface, which could only make it less
definite.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

Distance = tuple[Float[np.ndarray, " v"], Float[np.ndarray, "v 3"]]
"""Signed distance of points (negative within the body) and the outward unit normals there."""


@runtime_checkable
class Body(Protocol):
    """Something solid."""

    @property
    def friction(self) -> float:
        """Coulomb friction coefficient."""
        ...

    def distance(self, x: Float[np.ndarray, "v 3"]) -> Distance:
        """Signed distance and outward normals of points."""
        ...


@dataclass(frozen=True, eq=False)
class Plane:
    """A table or wall: the half space behind the plane through ``point`` with the outward unit ``normal``."""

    point: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    friction: float = 0.3

    def distance(self, x: Float[np.ndarray, "v 3"]) -> Distance:
        """Height above the plane."""
        return (x - self.point) @ self.normal, np.broadcast_to(self.normal, x.shape)


@dataclass(frozen=True, eq=False)
class TableEdge:
    """A table with an edge at ``point``, rounded with ``radius``, between faces with normals ``up`` and ``outward``."""

    point: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    outward: Float[np.ndarray, "3"]
    radius: float
    friction: float = 0.3

    def distance(self, x: Float[np.ndarray, "v 3"]) -> Distance:
        """Distance to the rounded wedge."""
        above = (x - self.point) @ self.up + self.radius
        beyond = (x - self.point) @ self.outward + self.radius
        corner = (above > 0) & (beyond > 0)
        reach = np.hypot(np.maximum(above, 0), np.maximum(beyond, 0))
        distance = np.where(corner, reach, np.maximum(above, beyond)) - self.radius
        scale = np.maximum(reach, 1e-12)
        along_up = np.where(corner, above / scale, (above >= beyond).astype(float))
        along_out = np.where(corner, beyond / scale, (above < beyond).astype(float))
        return distance, along_up[:, None] * self.up + along_out[:, None] * self.outward


@dataclass(frozen=True, eq=False)
class Cylinder:
    """An endless rod along the unit ``axis`` through ``point``."""

    point: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    friction: float = 0.3

    def distance(self, x: Float[np.ndarray, "v 3"]) -> Distance:
        """Distance to the rod's surface."""
        arm = x - self.point
        arm = arm - (arm @ self.axis)[:, None] * self.axis
        return _from_centre(arm, self.radius)


@dataclass(frozen=True, eq=False)
class Sphere:
    """A finger tip."""

    centre: Float[np.ndarray, "3"]
    radius: float
    friction: float = 0.3

    def distance(self, x: Float[np.ndarray, "v 3"]) -> Distance:
        """Distance to the sphere."""
        return _from_centre(x - self.centre, self.radius)


def _from_centre(arm: np.ndarray, radius: float) -> Distance:
    reach = np.linalg.norm(arm, axis=1)
    return reach - radius, arm / np.maximum(reach, 1e-12)[:, None]


@dataclass(frozen=True, eq=False)
class Touch:
    """A body in contact during one step.

    stiffness: (V,) force per depth. start: positions at the start of the step. pressure: (V,) the contact force there,
    from which friction is computed during the step (lagged: friction then has a potential and can only dissipate
    energy). slip: tangential travel below which friction holds a vertex like a spring.
    """

    body: Body
    stiffness: Float[np.ndarray, " v"]
    start: Float[np.ndarray, "v 3"]
    pressure: Float[np.ndarray, " v"]
    normal: Float[np.ndarray, "v 3"]
    slip: float


def touch(body: Body, x: Float[np.ndarray, "v 3"], stiffness: Float[np.ndarray, " v"], slip: float) -> Touch:
    """The contact of a sheet at ``x`` with a body for the step that begins there."""
    distance, normal = body.distance(x)
    return Touch(body, stiffness, x, stiffness * np.maximum(-distance, 0.0), normal, slip)


def contact_energy(contact: Touch, x: Float[np.ndarray, "v 3"]) -> float:
    """Energy of the contact springs."""
    distance, _ = contact.body.distance(x)
    return float(0.5 * np.sum(contact.stiffness * np.maximum(-distance, 0.0) ** 2))


def friction_loss(contact: Touch, x: Float[np.ndarray, "v 3"]) -> float:
    """Energy lost to friction from the step's start to ``x``: mu N (t - slip / 2), quadratic in t below ``slip``."""
    travel = np.linalg.norm(_slide(contact, x), axis=1)
    eased = np.where(travel < contact.slip, travel**2 / (2 * contact.slip), travel - 0.5 * contact.slip)
    return float(contact.body.friction * np.sum(contact.pressure * eased))


def contact_gradient(
    contact: Touch, x: Float[np.ndarray, "v 3"]
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3 3"]]:
    """Gradient of contact and friction, and a positive semi-definite Hessian for each vertex."""
    distance, normal = contact.body.distance(x)
    pressing = contact.stiffness * np.maximum(-distance, 0.0)
    slide = _slide(contact, x)
    travel = np.linalg.norm(slide, axis=1)
    hold = contact.body.friction * contact.pressure / np.maximum(travel, contact.slip)
    hessian = (contact.stiffness * (distance < 0))[:, None, None] * _outer(normal)
    hessian += hold[:, None, None] * (np.eye(3) - _outer(contact.normal))
    return hold[:, None] * slide - pressing[:, None] * normal, hessian


def entering(
    contact: Touch, x: Float[np.ndarray, "v 3"], ahead: Float[np.ndarray, "v 3"]
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3 3"]]:
    """Gradient and Hessian added by vertices that are outside the body at ``x`` and would be inside it at ``ahead``.

    Their springs act as if they touched already: the linear model then lands them on the surface.
    """
    distance, normal = contact.body.distance(x)
    landing, _ = contact.body.distance(ahead)
    spring = contact.stiffness * ((distance >= 0) & (landing < 0))
    return (spring * distance)[:, None] * normal, spring[:, None, None] * _outer(normal)


def _slide(contact: Touch, x: np.ndarray) -> np.ndarray:
    """Travel since the start of the step, along the body's surface."""
    travel = x - contact.start
    return travel - np.einsum("vk,vk->v", travel, contact.normal)[:, None] * contact.normal


def _outer(normal: np.ndarray) -> np.ndarray:
    return normal[:, :, None] * normal[:, None, :]
