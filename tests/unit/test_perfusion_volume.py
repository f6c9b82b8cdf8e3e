"""The hull of a cast against bodies whose closing is known in closed form, and against a liver."""

import numpy as np
import pytest
from scipy.integrate import quad

from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree
from vascval.imaging import perfusion_volume as module
from vascval.imaging.perfusion_volume import closing, perfusion_volume, terminal_spacing_mm
from vascval.io.trees import read_tree
from vascval.io.volumes import Volume, read_volume


def field(distance, half_mm: float, voxel_mm: float) -> Volume:
    """A signed distance on a cubic grid of ``[-half, half]^3``."""
    n = int(np.ceil(half_mm / voxel_mm))
    axis = voxel_mm * np.arange(-n, n + 1)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    return Volume(distance(x, y, z), np.full(3, voxel_mm), np.full(3, -n * voxel_mm))


def volume_mm3(inside: np.ndarray, voxel_mm: float) -> float:
    return float(np.count_nonzero(inside) * voxel_mm**3)


def cap_mm3(radius: float, height: float) -> float:
    return np.pi * height**2 * (radius - height / 3.0)


def dented(x, y, z, ball: float, dent: float):
    """A ball about 0 without a smaller one about its top: the distance is right near the wall."""
    body = np.sqrt(x**2 + y**2 + z**2) - ball
    hole = np.sqrt(x**2 + y**2 + (z - ball) ** 2) - dent
    return np.maximum(body, -hole)


def dented_mm3(ball: float, dent: float, fill: float | None) -> float:
    """Its volume; closed by balls of radius ``fill``: the dent is left or, if they are larger than it, they rest on
    its rim."""
    rim_height = ball - dent**2 / (2.0 * ball)
    rim = np.sqrt(ball**2 - rim_height**2)
    below_rim = 4.0 / 3.0 * np.pi * ball**3 - cap_mm3(ball, ball - rim_height)
    if fill is None or fill <= dent:
        # what the dent takes below the plane of the rim
        return below_rim - cap_mm3(dent, dent - (ball - rim_height))
    return below_rim - cap_mm3(fill, fill - np.sqrt(fill**2 - rim**2))


@pytest.mark.parametrize("radius", [2.0, 12.0, 20.0])
def test_ball_with_a_dent(radius):
    voxel = 0.5
    inside = closing(field(lambda x, y, z: dented(x, y, z, 10.0, 6.0), 10.0 + radius + 2.0, voxel), radius)
    wanted = dented_mm3(10.0, 6.0, radius)
    # two distances that are each a tenth of a voxel too long move a wall of 0.3 mm^2 per mm^3 by less than 0.05 mm
    assert volume_mm3(inside, voxel) == pytest.approx(wanted, rel=0.015)
    middle = inside.shape[0] // 2
    at_bottom_of_dent = inside[middle + round(5.5 / voxel), middle, middle]
    assert at_bottom_of_dent == (radius > 6.0)


def neck_mm3(ball: float, apart: float, radius: float, margin: float) -> float:
    """Closing of two balls by balls of ``radius``, and ``margin`` around it: the neck between them is what a circle
    of radius ``radius - margin`` leaves that rolls around the axis, touching both."""
    ring = np.sqrt((ball + radius) ** 2 - (apart / 2) ** 2)
    touch = (apart / 2) * (radius - margin) / (ball + radius)
    rolls = radius - margin
    neck, _ = quad(lambda z: np.pi * max(ring - np.sqrt(rolls**2 - z**2), 0.0) ** 2, -touch, touch)
    outer = ball + margin
    beyond = cap_mm3(outer, outer + apart / 2 - touch)
    return neck + 2.0 * beyond


@pytest.mark.parametrize("margin", [0.0, 1.0])
def test_two_lobes_are_joined_by_a_concave_neck(margin):
    ball, apart, radius, voxel = 8.0, 18.0, 9.0, 0.5

    def lobes(x, y, z):
        return np.minimum(*(np.sqrt(x**2 + y**2 + (z - s * apart / 2) ** 2) - ball for s in (-1, 1)))

    inside = closing(field(lobes, apart / 2 + ball + radius + 3.0, voxel), radius, margin_mm=margin)
    assert volume_mm3(inside, voxel) == pytest.approx(neck_mm3(ball, apart, radius, margin), rel=0.015)
    middle = inside.shape[0] // 2
    waist = np.count_nonzero(inside[middle]) * voxel**2
    ring = np.sqrt((ball + radius) ** 2 - (apart / 2) ** 2)
    assert waist == pytest.approx(np.pi * (ring - radius + margin) ** 2, rel=0.06)  # 0.1 mm of the radius
    assert waist < 0.8 * np.pi * ball**2


def test_lobes_far_apart_stay_apart():
    def lobes(x, y, z):
        return np.minimum(*(np.sqrt(x**2 + y**2 + (z - s * 12.0) ** 2) - 5.0 for s in (-1, 1)))

    inside = closing(field(lobes, 24.0, 0.5), 5.0)
    assert volume_mm3(inside, 0.5) == pytest.approx(2 * 4 / 3 * np.pi * 125, rel=0.02)
    assert not inside[inside.shape[0] // 2].any()


def test_the_error_falls_with_the_voxel():
    wanted = neck_mm3(8.0, 18.0, 9.0, 1.0)

    def lobes(x, y, z):
        return np.minimum(*(np.sqrt(x**2 + y**2 + (z - s * 9.0) ** 2) - 8.0 for s in (-1, 1)))

    error = []
    for voxel in (2.0, 1.0, 0.5):
        inside = closing(field(lobes, 29.0, voxel), 9.0, margin_mm=1.0)
        error.append(abs(volume_mm3(inside, voxel) / wanted - 1.0))
    assert error[2] < 0.25 * error[0]  # 12, 1.1, 1.0 %
    assert error[2] < 0.012


def star(n_terminals: int, seed: int, reach_mm: float = 40.0) -> Tree:
    """Straight vessels from 0 to random points of a ball."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(n_terminals, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    tips = direction * (reach_mm * np.cbrt(rng.random(n_terminals)))[:, None]
    parent = np.concatenate(([-1, 0], np.ones(n_terminals, int)))
    position = np.concatenate(([[0, 0, 0], [0, 0, 1]], tips))
    return Tree(Topology(parent), position, np.concatenate(([0, 2.0], np.full(n_terminals, 0.5))))


def holds(mask: Volume, points: np.ndarray) -> np.ndarray:
    index = np.rint(mask.to_index(points)).astype(int)
    within = ((index >= 0) & (index < mask.values.shape[::-1])).all(axis=1)
    x, y, z = np.where(within[:, None], index, 0).T
    return within & (mask.values[z, y, x] == 1)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("n_terminals", [8, 200])
def test_all_vessels_are_inside_by_the_margin(n_terminals, seed):
    tree = star(n_terminals, seed)
    hull = perfusion_volume(tree)
    assert set(np.unique(hull.mask.values)) == {0, 1}
    tips = tree.position_mm[1:]
    assert holds(hull.mask, tips).all()
    rng = np.random.default_rng(0)
    around = rng.normal(size=(tips.shape[0], 20, 3))
    voxel = hull.mask.spacing_mm[0]
    assert voxel <= hull.margin_mm / 5.0
    around *= (hull.margin_mm - 1.5 * voxel) / np.linalg.norm(around, axis=2, keepdims=True)
    assert holds(hull.mask, (tips[:, None] + around).reshape(-1, 3)).all()


def test_many_terminals_of_a_ball_give_the_ball():
    hull = perfusion_volume(star(3000, 1))
    assert hull.n_voids_filled == 0
    # the margin makes up for what lies beyond the outermost terminals
    assert hull.volume_mm3 == pytest.approx(4 / 3 * np.pi * 40.0**3, rel=0.03)
    assert hull.radius_mm == pytest.approx(4 * hull.margin_mm)


def test_an_empty_middle_is_filled():
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(400, 3))
    tips = 30.0 * direction / np.linalg.norm(direction, axis=1)[:, None]
    order = np.argsort(tips[:, 2])
    chain = Tree(
        Topology(np.concatenate(([-1, 0], np.ones(399, int)))),
        np.concatenate((tips[order[:2]], tips[order[2:]], tips[order[:1]] + 0.5)),
        np.full(401, 0.3),
    )
    shell = perfusion_volume(chain, radius_mm=6.0, margin_mm=2.0)
    assert holds(shell.mask, np.zeros((1, 3))).all()


def test_a_larger_radius_gives_a_larger_hull():
    tree = star(40, 5)
    volumes = [perfusion_volume(tree, radius_mm=r, margin_mm=3.0).volume_mm3 for r in (4.0, 8.0, 20.0, 60.0)]
    assert np.all(np.diff(volumes) > 0)
    from scipy.spatial import ConvexHull

    assert volumes[-1] > 0.8 * ConvexHull(tree.position_mm).volume


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radius_mm": -1.0, "margin_mm": 1.0}, "the radius of the hull is -1.0 mm"),
        ({"radius_mm": 5.0, "margin_mm": np.nan}, "the margin of the hull is nan mm"),
        ({"radius_mm": 5.0, "margin_mm": 0.01}, "the margin of 0.01 mm is too small for a hull of this size"),
        ({"radius_mm": 5.0, "margin_mm": 1.0, "voxel_mm": 0.8}, "voxels of 0.8 mm cannot show a margin of 1 mm"),
    ],
)
def test_refusals(options, message):
    with pytest.raises(InputError, match=message):
        perfusion_volume(star(10, 1), **options)


def test_ends_in_a_plane_span_no_volume():
    tree = Tree(
        Topology(np.array([-1, 0, 1, 1, 1, 1])),
        np.array([[0, 0, 0], [0, 0, 5], [5, 0, 9], [-5, 0, 9], [5, 0, 12], [-4, 0, 14]], float),
        np.full(6, 0.5),
    )
    with pytest.raises(InputError, match="the 4 ends of vessels span no volume"):
        perfusion_volume(tree)
    assert perfusion_volume(tree, radius_mm=6.0, margin_mm=2.0).volume_mm3 > 0


def test_spacing_is_that_of_a_lattice():
    axis = np.arange(6.0)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    tree = Tree(
        Topology(np.concatenate(([-1, 0], np.ones(216, int)))),
        np.concatenate(([[-1, 0, 0.5], [-0.5, 0.5, 0.5]], points)),
        np.full(218, 0.1),
    )
    assert terminal_spacing_mm(tree) == pytest.approx((125 / 216) ** (1 / 3))


def test_the_hull_of_a_dense_tree_is_its_liver(shared_data):
    """Dice of the hull of 2,000 terminals grown in a liver with that liver, closed."""
    tree = read_tree(shared_data("ircad01", "cco_in_liver_2000.vtp"))
    liver = read_volume(shared_data("ircad01", "3Dircadb1.1_liver_mask.nrrd"))
    hull = perfusion_volume(tree)
    centres = hull.mask.to_world(np.argwhere(hull.mask.values == 1)[:, ::-1])
    inside = np.count_nonzero(holds(liver, centres)) * float(np.prod(hull.mask.spacing_mm))
    volume = float(np.count_nonzero(liver.values) * np.prod(liver.spacing_mm))
    dice = 2 * inside / (hull.volume_mm3 + volume)
    assert 0.93 < dice < 0.99  # 0.95; the vessels are carved out of the mask, 2 % of it
    assert 1.0 < hull.volume_mm3 / volume < 1.12


def test_defaults_are_as_documented():
    assert (module.RADIUS_SPACINGS, module.MARGIN_SPACINGS) == (2.0, 0.5)
