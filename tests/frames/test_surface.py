"""Areas and slopes of what pixels see, against rays cut with planes in float64."""

import numpy as np
import pytest

from sssfit.frames import surface
from sssfit.frames.camera import orthographic, perspective

CAMERAS = {
    "perspective": perspective(24, 16, fx=40.0, fy=50.0, cx=9.0),
    "orthographic": orthographic(24, 16, 0.5),
}
NORMALS = [(0.0, 0.0, 1.0), (0.48, 0.0, 0.88), (-0.3, 0.5, 0.812), (0.0, -0.6, 0.8)]


def rays(camera):
    """Starts and directions for each unit of depth at a pixel coordinate."""

    def ray(column, row):
        x, y = (column - camera.cx) / camera.fx, (camera.cy - row) / camera.fy
        if camera.projection == "perspective":
            return np.zeros(3), np.array([x, y, -1.0])
        return np.array([x, y, 0.0]), np.array([0, 0, -1.0])

    return ray


def depth_on(normal, through, ray):
    start, direction = ray
    return np.dot(normal, through - start) / np.dot(normal, direction)


@pytest.fixture(params=CAMERAS)
def camera(request):
    return CAMERAS[request.param]


@pytest.mark.parametrize("normal", NORMALS)
def test_areas_and_slopes_of_a_plane(camera, normal):
    normal = np.array(normal) / np.linalg.norm(normal)
    through, ray = np.array([1.0, -2.0, -300.0]), rays(camera)
    depth = np.array(
        [[depth_on(normal, through, ray(i + 0.5, j + 0.5)) for i in range(24)] for j in range(16)]
    )
    everywhere = np.broadcast_to(normal, (16, 24, 3)).astype(np.float32)
    area = np.asarray(surface.pixel_area(depth.astype(np.float32), everywhere, camera))
    by_column, by_row = surface.depth_slopes(depth.astype(np.float32), everywhere, camera)
    for j, i in [(0, 0), (8, 12), (15, 23), (3, 20)]:
        corners = [ray(i + u, j + v) for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))]
        points = [start + depth_on(normal, through, (start, way)) * way for start, way in corners]
        diagonals = np.cross(points[2] - points[0], points[3] - points[1])
        # Exact for the quadrilateral, which differs from the parallelogram in the second order of a pixel.
        assert area[j, i] == pytest.approx(np.linalg.norm(diagonals) / 2, rel=2e-3)
        ahead, behind = (depth_on(normal, through, ray(i + 0.5 + e, j + 0.5)) for e in (0.01, -0.01))
        assert by_column[j, i] == pytest.approx((ahead - behind) / 0.02, rel=1e-5, abs=1e-4)
        below, above = (depth_on(normal, through, ray(i + 0.5, j + 0.5 + e)) for e in (0.01, -0.01))
        assert by_row[j, i] == pytest.approx((below - above) / 0.02, rel=1e-5, abs=1e-4)


def test_sharp_and_averted_normals_count_at_the_smallest_cosine(camera):
    averted = np.broadcast_to(np.array([0.6, 0.0, -0.8], np.float32), (16, 24, 3))
    depth = np.full((16, 24), 100, np.float32)
    across, up = (np.broadcast_to(n, depth.shape) for n in camera.pixels_per_mm(depth))
    area = np.asarray(surface.pixel_area(depth, averted, camera))
    np.testing.assert_allclose(area, 1 / (across * up * surface.MIN_COSINE), rtol=1e-6)
    slopes = np.asarray(surface.depth_slopes(depth, averted, camera)[0])
    np.testing.assert_allclose(slopes, 0.6 / (across * surface.MIN_COSINE), rtol=1e-6)
