import cv2
import numpy as np
import pytest
from jaxtyping import Float, Int

from recon.silhouettes.hull import ball
from reports.mesh_picture import mesh_picture
from reports.photo import thumbnail_jpeg
from reports.raycast import TracedSurface, Viewing

RADIUS_MM = 30.0
Mesh = tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]


def sphere(radius):
    directions, faces = ball(5)
    return radius * directions, faces


@pytest.fixture(scope="module")
def fruit():
    return sphere(RADIUS_MM)


def picture(fruit, **more):
    png = mesh_picture(*fruit, view_px=160, samples=1, **more)
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    return np.asarray(image)[..., ::-1].astype(int)


def front_view(azimuth_deg, elevation_deg=0.0):
    return Viewing(
        centre_mm=np.zeros(3),
        azimuth_deg=azimuth_deg,
        elevation_deg=elevation_deg,
        half_width_mm=40.0,
        half_height_mm=40.0,
    )


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(0.0, 0.0), (35.0, 24.0), (215.0, 80.0)])
def test_rays_see_the_sphere_where_it_is(fruit, azimuth_deg, elevation_deg):
    view = front_view(azimuth_deg, elevation_deg)
    visible = TracedSurface.of(*fruit).seen_from(view, width_px=200, height_px=200)
    assert visible.hit.mean() * 80.0**2 == pytest.approx(np.pi * RADIUS_MM**2, rel=0.01)
    points = visible.points_mm[visible.hit]
    assert np.linalg.norm(points, axis=1) == pytest.approx(RADIUS_MM, abs=0.1)
    assert np.abs(visible.normals[visible.hit] - points / RADIUS_MM).max() < 0.03
    assert (visible.normals[visible.hit] @ view.axes[2] > -0.05).all()


def test_view_axes_are_right_handed_and_up_is_up():
    for azimuth_deg in (0.0, 35.0, 215.0):
        axes = front_view(azimuth_deg, 24.0).axes
        assert np.allclose(axes @ axes.T, np.eye(3))
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert axes[1, 2] > 0
    assert np.allclose(front_view(0.0).axes[0], [0, 1, 0])


def test_shadow_falls_under_the_fruit_and_not_far_from_it(fruit):
    below, far = np.array([0.0, 0.0, -RADIUS_MM - 0.5]), np.array([500.0, 0.0, -RADIUS_MM])
    dark = TracedSurface.of(*fruit).shaded(np.stack([below, far]))
    assert dark[0] > 0.95
    assert dark[1] < 0.05


def test_nearest_point_of_a_sphere_is_along_the_radius(fruit):
    nearest = TracedSurface.of(*fruit).nearest(np.array([[50.0, 0.0, 0.0], [0.0, -45.0, 0.0]]))
    assert np.allclose(nearest, [[RADIUS_MM, 0, 0], [0, -RADIUS_MM, 0]], atol=0.2)


def test_pit_darkens_only_the_middle(fruit):
    bare, pitted = picture(fruit), picture(fruit, pit_vertices=sphere(10.0)[0], pit_faces=sphere(10.0)[1])
    change = np.abs(bare - pitted)[:, :160].sum(axis=2)
    assert (bare - pitted)[70:82, 76:84].mean() > 30
    assert change[40, 30:130].max() == 0
    assert change[75, 125:].max() == 0


def test_contact_is_painted_on_the_side_that_was_touched(fruit):
    towards = np.array([np.cos(np.deg2rad(35)), np.sin(np.deg2rad(35)), 0.0])
    across = np.array([-towards[1], towards[0], 0.0])
    u, v = (axis.ravel()[:, None] for axis in np.meshgrid(np.linspace(-6, 6, 13), np.linspace(-6, 6, 13)))
    grid = 29.0 * towards + u * across + v * np.array([0, 0, 1.0])
    bare, touched = picture(fruit), picture(fruit, contacts_mm={"left": grid, "right": np.empty((0, 3))})
    change = np.abs(bare - touched).sum(axis=2)
    change[:, :70][:40] = 0  # the legend
    painted = change > 60
    assert painted[:, 160:].sum() == 0
    mm_per_px = 2 * 0.72 * 2 * RADIUS_MM / 160
    seen_area = painted.sum() * mm_per_px**2 / np.cos(np.deg2rad(24))
    assert seen_area == pytest.approx(13.0**2, rel=0.25)


def test_same_mesh_gives_the_same_picture(fruit):
    assert mesh_picture(*fruit, view_px=80, samples=1) == mesh_picture(*fruit, view_px=80, samples=1)


def test_thumbnail_keeps_the_shape_and_never_grows():
    photo = np.full((600, 900, 3), 120, np.uint8)
    for longest_px, expected in ((300, (200, 300, 3)), (2000, (600, 900, 3))):
        jpeg = thumbnail_jpeg(photo, longest_px=longest_px)
        assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape == expected
