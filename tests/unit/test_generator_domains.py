import numpy as np
import pytest
import pyvista

from generator.config import DomainConfig
from generator.domain import Box
from generator.domain_shapes import SHAPES, ShapeDomain
from generator.domain_surface import SurfaceDomain
from generator.domain_volume import VoxelDomain
from generator.domains import make_domain
from generator.surface_files import read_surface
from vascval.core.errors import InputError
from vascval.io.volumes import Volume, write_volume


def arrays(surface: pyvista.PolyData) -> tuple[np.ndarray, np.ndarray]:
    surface = surface.triangulate()
    return np.asarray(surface.points, dtype=np.float64), np.asarray(surface.faces).reshape(-1, 4)[:, 1:]


def sphere(centre=(0.0, 0.0, 0.0), radius=10.0) -> tuple[np.ndarray, np.ndarray]:
    return arrays(pyvista.Sphere(radius=radius, center=centre, theta_resolution=40, phi_resolution=40))


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    offset = np.cumsum([0, *(len(points) for points, _ in parts)])
    return np.vstack([p for p, _ in parts]), np.vstack([f + k for (_, f), k in zip(parts, offset)])


def bent_mask() -> np.ndarray:
    """Two legs and a bar, (z, y, x)."""
    mask = np.zeros((6, 20, 30), np.uint8)
    mask[:, 2:18, 2:8] = 1
    mask[:, 2:18, 22:28] = 1
    mask[:, 12:18, 2:28] = 1
    return mask


def turned(mask: np.ndarray) -> Volume:
    a = 0.3
    direction = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return Volume(mask, np.array([0.5, 0.7, 2.0]), np.array([5.0, -3.0, 11.0]), direction)


DOMAINS = {
    "box": lambda: Box((4.0, 5.0, 6.0), (1.0, 2.0, 3.0)),
    "voxels": lambda: VoxelDomain(turned(bent_mask())),
    "sphere": lambda: SurfaceDomain(*sphere()),
    "horseshoe": lambda: ShapeDomain("horseshoe"),
    "liver": lambda: ShapeDomain("liver"),
}


@pytest.mark.parametrize("name", DOMAINS)
def test_volume_contains_and_sample_agree(name):
    domain = DOMAINS[name]()
    rng = np.random.default_rng(0)
    size = domain.upper_mm - domain.lower_mm
    points = domain.lower_mm + rng.random((40_000, 3)) * size
    inside = domain.contains(points)
    share = domain.volume_mm3 / size.prod()
    assert inside.mean() == pytest.approx(share, abs=4 * np.sqrt(0.25 / 40_000))  # four standard errors
    sample = domain.sample(20_000, rng)
    assert domain.contains(sample).all()
    # the middle of the sample is that of the points found inside: four standard errors of both
    error = 4 * np.sqrt(size**2 / 12 * (1 / 20_000 + 1 / inside.sum()))
    assert (np.abs(sample.mean(axis=0) - points[inside].mean(axis=0)) < error).all()
    assert domain.contains(np.array([[np.nan, 0, 0], [np.inf, 0, 0], domain.upper_mm + 1])).tolist() == [False] * 3


@pytest.mark.parametrize("name", DOMAINS)
def test_segments_are_inside_where_dense_samples_are(name):
    domain = DOMAINS[name]()
    rng = np.random.default_rng(1)
    ends = domain.sample(1200, rng).reshape(600, 2, 3)
    found = domain.segments_inside(ends[:, 0], ends[:, 1])
    steps = np.linspace(0, 1, 400)[:, None]
    expected = np.array([domain.contains(a + steps * (b - a)).all() for a, b in ends])
    assert not (found & ~expected).any()
    assert (expected & ~found).sum() <= 6  # a sliver between two samples
    if name in ("box", "sphere"):
        assert found.mean() > 0.98
    else:
        assert 0.2 < expected.mean() < 0.98


@pytest.mark.parametrize("name", ["box", "sphere", "horseshoe"])
def test_distance_to_the_wall(name):
    domain = DOMAINS[name]()
    points = domain.lower_mm + np.random.default_rng(2).random((300, 3)) * (domain.upper_mm - domain.lower_mm)
    distance = domain.wall_distance_mm(points)
    assert ((distance > 0) == domain.contains(points)).all()
    if name == "sphere":
        assert distance == pytest.approx(10 - np.linalg.norm(points, axis=1), abs=0.08)  # facets cut into the ball
    if name == "box":
        middle = (domain.lower_mm + domain.upper_mm) / 2
        assert domain.wall_distance_mm(middle[None])[0] == pytest.approx(2.0, abs=1e-12)
        assert domain.wall_distance_mm(middle[None] + [5.0, 0, 0])[0] == pytest.approx(-3.0, abs=1e-12)


def test_distance_to_the_wall_of_voxels():
    domain = VoxelDomain(turned(bent_mask()))
    points = domain.sample(50, np.random.default_rng(0))
    assert (domain.wall_distance_mm(points) >= 0).all()
    assert domain.wall_distance_mm(domain.upper_mm[None] + 10)[0] < -10


def test_shapes_have_their_volumes_and_roots():
    for name, shape in SHAPES.items():
        domain = ShapeDomain(name)
        assert domain.volume_mm3 == pytest.approx(shape.volume_mm3, rel=1e-9)  # rounding
        assert domain.contains(domain.root_mm[None])[0]
        assert not [note for note in domain.notes if "hole" in note]
    assert SHAPES["liver"].volume_mm3 == 1.5e6


def test_voxels_of_a_label_and_specks():
    mask = np.pad(bent_mask(), 3) * 4
    mask[0, 0, 0] = 4
    mask[:, 0, -1] = 2
    domain = VoxelDomain(turned(mask), label=4)
    assert domain.volume_mm3 == pytest.approx(np.count_nonzero(bent_mask()) * 0.7, rel=1e-12)
    assert domain.notes == ("1 smaller pieces of the domain, 1 voxels, were dropped",)
    with pytest.raises(InputError, match=r"no voxel of label 7 \(labels: 0, 2, 4\)"):
        VoxelDomain(turned(mask), label=7)


def test_pieces_are_refused_joined_or_dropped():
    mask = bent_mask()
    mask[:, :, 14:16] = 0
    with pytest.raises(InputError, match=r"2 pieces of 1,\d+, 9\d\d voxels|2 pieces of"):
        VoxelDomain(turned(mask))
    largest = VoxelDomain(turned(mask), keep="largest")
    closed = VoxelDomain(turned(mask), closing_mm=1.5)
    assert largest.volume_mm3 < 0.6 * closed.volume_mm3
    assert "1 smaller pieces" in largest.notes[0]


def test_background_alone_is_no_domain():
    with pytest.raises(InputError, match=r"the volume holds only background"):
        VoxelDomain(turned(np.zeros((4, 4, 4), np.uint8)))


def test_surfaces_are_mended():
    points, faces = sphere()
    whole = SurfaceDomain(points, faces)
    assert not whole.notes
    inward = SurfaceDomain(points, faces[:, ::-1])
    assert inward.notes == ("the normals of the surface pointed inward and were turned",)
    torn = SurfaceDomain(points, np.delete(faces, [100, 101], axis=0))
    assert [note for note in torn.notes if "were filled" in note]
    some = faces.copy()
    some[::7] = some[::7, ::-1]
    assert "triangles of the surface were turned to face one way" in SurfaceDomain(points, some).notes
    soup = SurfaceDomain(points[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3))
    for other in (inward, torn, SurfaceDomain(points, some), soup):
        assert other.volume_mm3 == pytest.approx(whole.volume_mm3, rel=2e-3)  # a filled hole is flat
    assert whole.volume_mm3 == pytest.approx(4 / 3 * np.pi * 1000, rel=0.01)  # facets


def test_a_cavity_is_outside():
    domain = SurfaceDomain(*joined(sphere(), sphere(radius=4.0)))
    assert domain.notes == ("1 cavities inside the surface are outside the domain",)
    assert domain.contains(np.array([[0.0, 0, 0], [7.0, 0, 0], [11.0, 0, 0]])).tolist() == [False, True, False]
    assert domain.volume_mm3 == pytest.approx(4 / 3 * np.pi * (1000 - 64), rel=0.01)
    assert not domain.segments_inside(np.array([[-7.0, 0, 0]]), np.array([[7.0, 0, 0]]))[0]


def test_separate_bodies_are_refused_or_the_largest_taken():
    two = joined(sphere(), sphere((30.0, 0, 0), 5.0))
    with pytest.raises(InputError, match=r"2 separate bodies of 4,\d+, 5\d\d mm\^3; one is needed"):
        SurfaceDomain(*two)
    domain = SurfaceDomain(*two, keep="largest")
    assert "the largest of 2 bodies was taken" in domain.notes
    assert not domain.contains(np.array([[30.0, 0, 0]]))[0]


@pytest.mark.parametrize(
    ("points", "faces", "message"),
    [
        (sphere()[0], sphere()[1][:600], r"the surface is open: a hole with an edge of \S+ mm near .* is too wide"),
        (np.full((4, 3), np.nan), [[0, 1, 2]] * 4, "4 vertices of the surface are not finite"),
        (np.eye(3), [[0, 1, 2]], "has 1 triangles; a closed one has at least 4"),
        (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1]]),
         [[0, 1, 2], [0, 1, 3], [0, 1, 4], [1, 2, 3]], "1 edges of the surface belong to more than two triangles"),
        (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]),
         [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], "encloses no volume; is it a flat sheet"),
    ],
)  # fmt: skip
def test_surfaces_that_cannot_be_mended(points, faces, message):
    with pytest.raises(InputError, match=message):
        SurfaceDomain(np.array(points), np.array(faces))


@pytest.mark.parametrize("size", [(1, 0, 1), (1, np.nan, 1), (1, -1, 1), (1, 1)])
def test_boxes_without_volume(size):
    with pytest.raises(InputError, match=r"has no volume; three positive sides"):
        Box(size)


@pytest.mark.parametrize("size", [(1e-300, 1, 1), (1, 1e200, 1), (1, 1, 1e-4)])
def test_boxes_of_absurd_size(size):
    """Their volume is 0 or infinite in floating point, or their grid of cells larger than memory."""
    with pytest.raises(InputError, match=r"holds no vessels; give sides from 1 um to 1 km"):
        Box(size)


@pytest.mark.parametrize("suffix", ["stl", "obj", "vtk", "vtp"])
def test_surface_files(tmp_path, suffix):
    path = tmp_path / f"ball.{suffix}"
    pyvista.Sphere(radius=10.0).save(path)
    domain = make_domain(DomainConfig(file=path))
    assert domain.volume_mm3 == pytest.approx(4 / 3 * np.pi * 1000, rel=0.03)  # facets
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=rf"ball.{suffix}: "):
        make_domain(DomainConfig(file=path))
    path.write_bytes(b"")
    with pytest.raises(InputError, match=r"the file is empty"):
        read_surface(path)


@pytest.mark.parametrize(
    ("given", "said"),
    [({"shape": "liver"}, "the domain is no file"), ({"box_mm": (9, 9, 9)}, "the domain is no file"),
     ({"file": "liver.stl"}, "liver.stl is a surface")],
)  # fmt: skip
def test_a_label_without_a_volume_is_refused(given, said):
    with pytest.raises(InputError, match=rf"domain.label 5: .* but {said}; name a volume as domain.file, or leave"):
        make_domain(DomainConfig(label=5, **given))


def test_volume_files_and_foreign_ones(tmp_path):
    write_volume(turned(bent_mask()), tmp_path / "mask.nrrd")
    assert make_domain(DomainConfig(file=tmp_path / "mask.nrrd")).volume_mm3 > 0
    with pytest.raises(InputError, match=r"none.stl: no such file; check domain.file"):
        make_domain(DomainConfig(file=tmp_path / "none.stl"))
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(InputError, match=r"a.txt: neither a volume nor a surface by its name"):
        make_domain(DomainConfig(file=tmp_path / "a.txt"))
    (tmp_path / "b.nrrd").write_text("x")
    with pytest.raises(InputError, match=r"b.nrrd: "):
        make_domain(DomainConfig(file=tmp_path / "b.nrrd"))
