"""The sheet: its slice-grid corners are vertices at every level, and the smooth surface is that of the sheet."""

import numpy as np
import pytest

from hybrid.errors import ConfigError
from hybrid.mesh.film import FilmMesh, film_mesh

GRID_U, GRID_V = np.array([0.03, 0.5, 0.97]), np.array([0.0, 0.3, 0.6, 1.0])


def triangle_areas(mesh: FilmMesh) -> np.ndarray:
    """Areas of the triangles as vectors along their normals, (t, 3)."""
    a, b, c = (mesh.vertices.reshape(-1, 3)[mesh.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_grid_corners_are_vertices_at_every_level(levels):
    mesh = film_mesh((430.0, 350.0), GRID_U, GRID_V, levels)
    u, v = np.meshgrid(GRID_U, GRID_V)
    expected = np.stack([(u - 0.5) * 350, (v - 0.5) * 430, np.zeros_like(u)], axis=-1)
    np.testing.assert_allclose(mesh.grid_vertices, expected, atol=1e-6)


def test_subdivision_halves_every_interval():
    coarse, fine = (film_mesh((430.0, 350.0), GRID_U, GRID_V, levels) for levels in (1, 2))
    np.testing.assert_allclose(fine.u_lines[::2], coarse.u_lines, atol=1e-9)
    assert fine.shape == (2 * coarse.shape[0] - 1, 2 * coarse.shape[1] - 1)


def test_triangles_cover_the_sheet_once_and_are_wound_alike():
    mesh = film_mesh((430.0, 350.0), GRID_U, GRID_V)
    areas = triangle_areas(mesh)
    assert (np.sign(areas[:, 2]) == np.sign(areas[0, 2])).all()
    np.testing.assert_allclose(np.linalg.norm(areas, axis=1).sum(), 430 * 350, rtol=1e-12)


def test_surface_of_a_cylinder_has_the_cylinders_normals():
    mesh = film_mesh((200.0, 300.0), np.linspace(0, 1, 5), np.linspace(0, 1, 4), 3)
    radius = 150.0
    angle = mesh.vertices[..., 0] / radius
    bent = np.stack([radius * np.sin(angle), mesh.vertices[..., 1], radius * (1 - np.cos(angle))], axis=-1)
    t = np.linspace(0.05, 0.95, 11)
    got = mesh.bent(bent).normals(t, t)
    turn = (t - 0.5) * 300 / radius
    expected = np.stack([np.sin(turn), np.zeros_like(turn), -np.cos(turn)], axis=-1)
    np.testing.assert_allclose(got, np.broadcast_to(expected, got.shape), atol=2e-4)
    np.testing.assert_allclose(mesh.bent(bent).edge_strain(), 0, atol=2e-4)


def test_a_flat_sheet_has_no_angles():
    mesh = film_mesh((430.0, 350.0), GRID_U, GRID_V, 1)
    np.testing.assert_allclose(mesh.angle_defects(), 0, atol=1e-9)


def test_a_folded_sheet_has_no_gaussian_curvature():
    """The fold runs along diagonals of the cells, which are the triangle edges with x + y = constant."""
    mesh = film_mesh((100.0, 100.0), np.linspace(0, 1, 3), np.linspace(0, 1, 3), 1)
    beyond = np.maximum(mesh.vertices[..., 0] + mesh.vertices[..., 1], 0)[..., None] / np.sqrt(2)
    flat, turned = np.array([1, 1, 0]) / np.sqrt(2), np.array([np.cos(0.5), np.cos(0.5), np.sqrt(2) * np.sin(0.5)])
    folded = mesh.bent(mesh.vertices + beyond * (turned / np.sqrt(2) - flat))
    np.testing.assert_allclose(folded.angle_defects(), 0, atol=1e-9)


def test_angle_defects_of_a_cap_add_up_to_its_solid_angle():
    mesh = film_mesh((100.0, 100.0), np.linspace(0, 1, 5), np.linspace(0, 1, 5), 3)
    x, y = mesh.vertices[..., 0], mesh.vertices[..., 1]
    cap = mesh.bent(np.stack([x, y, np.sqrt(200.0**2 - x**2 - y**2)], axis=-1))
    inner = cap.angle_defects()
    area = np.linalg.norm(triangle_areas(cap), axis=1).sum()
    expected = area / 200.0**2 * inner.size / (x.size - sum(x.shape) + 1)
    assert inner.sum() == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("grid", [np.array([0.5, 0.2]), np.array([0.0, 1.2]), np.array([0.5])])
def test_impossible_grid_lines_are_refused(grid):
    with pytest.raises(ConfigError, match="grid_u"):
        film_mesh((430.0, 350.0), grid, GRID_V)
