"""Small sound files of every format, made by code: what fuzzing begins with."""

from __future__ import annotations

import gzip
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vascval.core.tree import Topology, Tree
from vascval.io.trees import write_swc, write_vtp
from vascval.io.volumes import Volume, write_volume

Seeds = tuple[bytes, ...]


def tree() -> Tree:
    position = np.array([[0, 0, 0], [0, 0, 10], [5, 0, 15], [-5, 0, 15.0]])
    return Tree(Topology(np.array([-1, 0, 1, 1])), position, np.array([0, 2.0, 1.5, 1.0]))


def values() -> np.ndarray:
    return np.arange(24, dtype=np.uint8).reshape(2, 3, 4)


def written(name: str, write: Callable[[Path], object]) -> bytes:
    """The bytes of the file that ``write(path)`` makes under that name."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        write(path)
        return path.read_bytes()


# --- trees --------------------------------------------------------------------------------------------------------


def vtp() -> Seeds:
    array = '<DataArray type="{}" Name="{}" {} format="ascii">{}</DataArray>'
    text = (
        '<?xml version="1.0"?><VTKFile type="PolyData" version="1.0" byte_order="LittleEndian"><PolyData>'
        '<FieldData><DataArray type="String" Name="units" format="ascii">123 125 0</DataArray></FieldData>'
        '<Piece NumberOfPoints="4" NumberOfLines="3"><Points>'
        + array.format("Float64", "Points", 'NumberOfComponents="3"', "0 0 0 0 0 10 5 0 15 -5 0 15")
        + f"</Points><Lines>{array.format('Int64', 'connectivity', '', '0 1 1 2 1 3')}"
        + f"{array.format('Int64', 'offsets', '', '2 4 6')}</Lines>"
        + f"<CellData>{array.format('Float64', 'radius', '', '2 1 1')}</CellData>"
        "</Piece></PolyData></VTKFile>"
    )
    return text.encode(), written("a.vtp", lambda path: write_vtp(tree(), path)), _vtk_xml("zlib"), _vtk_xml("lz4")


def _vtk_xml(compressor: str) -> bytes:
    """The same tree as VTK itself packs it."""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

    def write(path: Path) -> None:
        write_vtp(tree(), path)
        reader = vtkXMLPolyDataReader()
        reader.SetFileName(str(path))
        reader.Update()
        writer = vtkXMLPolyDataWriter()
        writer.SetInputData(reader.GetOutput())
        writer.SetDataModeToBinary()
        {"zlib": writer.SetCompressorTypeToZLib, "lz4": writer.SetCompressorTypeToLZ4}[compressor]()
        writer.SetFileName(str(path))
        writer.Write()

    return written("a.vtp", write)


def vtk() -> Seeds:
    head = "# vtk DataFile Version {}\nx\n{}\nDATASET POLYDATA\nPOINTS 4 double\n"
    points = "0 0 0 0 0 10 5 0 15 -5 0 15\n"
    old = head.format("3.0", "ASCII") + points + (
        "LINES 3 9\n2 0 1\n2 1 2\n2 1 3\nCELL_DATA 3\nSCALARS radius double 1\nLOOKUP_TABLE default\n2 1 1\n"
        "POINT_DATA 4\nFIELD FieldData 1\nthing 1 4 int\n1 2 3 4\nVECTORS v float\n1 0 0 1 0 0 1 0 0 1 0 0\n"
    )  # fmt: skip
    new = head.format("5.1", "ASCII") + points + (
        "METADATA\nINFORMATION 0\n\nLINES 4 6\nOFFSETS vtktypeint64\n0 2 4 6\nCONNECTIVITY vtktypeint64\n0 1 1 2 1 3\n"
        "CELL_DATA 3\nFIELD FieldData 2\nradius 1 3 double\n2 1 1\nunit 1 1 string\num\n"
    )  # fmt: skip
    binary = (
        head.format("3.0", "BINARY").encode() + np.array([0, 0, 0, 0, 0, 10, 5, 0, 15, -5, 0, 15], ">f8").tobytes()
        + b"\nLINES 3 9\n" + np.array([2, 0, 1, 2, 1, 2, 2, 1, 3], ">i4").tobytes()
        + b"\nCELL_DATA 3\nSCALARS radius double 1\nLOOKUP_TABLE default\n" + np.array([2, 1, 1], ">f8").tobytes()
        + b"\nFIELD FieldData 1\nunit 1 1 string\n\xc2mm\n"
    )  # fmt: skip
    return old.encode(), new.encode(), binary


def swc() -> Seeds:
    own = written("a.swc", lambda path: write_swc(tree(), path))
    return own, b"# unit: um\n1 1 0 0 0 5 -1\n2 3 0 0 10 4.5 1\n3 3 5 0 15 3 2\n4 3 -5,0;15 3e0 2 # note\n"


def gxl() -> Seeds:
    node = (
        '<node id="{}"><attr name="nodeType"><string>{}</string></attr>'
        '<attr name="position"><tup>{}</tup></attr></node>'
    )
    edge = (
        '<edge id="{}" from="{}" to="{}"><attr name="flow"><float>1</float></attr>'
        '<attr name="radius"><float>{}</float></attr></edge>'
    )
    three = "<float>{}</float><float>{}</float><float>{}</float>"
    nodes = (("a", "root node", (0, 0, 0)), ("b", "bifurcation", (0, 0, 9)), ("c", "terminal node", (5, 0, 15)),
             ("d", "terminal node", (-5, 0, 15)))  # fmt: skip
    text = "".join(node.format(name, kind, three.format(*at)) for name, kind, at in nodes)
    text += "".join(edge.format(*row) for row in (("e", "a", "b", 2), ("f", "b", "c", 1), ("g", "b", "d", 1)))
    return (
        f'<?xml version="1.0"?><gxl><graph id="t" edgeids="true" edgemode="directed">{text}</graph></gxl>'.encode(),
    )


# --- volumes ------------------------------------------------------------------------------------------------------


def _nrrd_header(encoding: str, extra: str = "") -> bytes:
    return (
        f"NRRD0004\n# comment\ntype: uchar\ndimension: 3\nspace: left-posterior-superior\nsizes: 4 3 2\n"
        "space directions: (1,0,0) (0,1,0) (0,0,2)\nspace origin: (0,0,0)\nkinds: domain domain domain\n"
        f'endian: little\nencoding: {encoding}\nspace units: "mm" "mm" "mm"\nkey:=value\n{extra}'
    ).encode()


def nrrd() -> Seeds:
    raw = values().tobytes()
    plain = b"NRRD0004\ntype: short\ndimension: 3\nsizes: 4 3 2\nspacings: 1 1 1\nencoding: raw\nendian: big\n\n"
    return (
        _nrrd_header("raw") + b"\n" + raw,
        _nrrd_header("gzip") + b"\n" + gzip.compress(raw, mtime=0),
        _nrrd_header("ascii") + b"\n" + b" ".join(str(value).encode() for value in raw) + b"\n",
        plain + raw + raw,
    )


def nhdr() -> Seeds:
    """Headers of data that lie beside them (see ``targets``: ``a.raw``, ``s001.raw``, ``s002.raw``)."""
    return (
        _nrrd_header("raw", "data file: a.raw\n"),
        _nrrd_header("raw", "byte skip: -1\ndata file: s%03d.raw 1 2 1\n"),
        _nrrd_header("raw", "line skip: 0\ndata file: LIST\ns001.raw\ns002.raw\n"),
    )


def nii() -> Seeds:
    one = written("a.nii", lambda path: write_volume(Volume(values(), np.array([1, 1, 2.0])), path))
    return (one,)


_MHD = (
    "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = {big}\nCompressedData = {packed}\n"
    "TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\nElementSpacing = 1 1 2\nDimSize = 4 3 2\n"
    "ElementType = {type}\nElementDataFile = {file}\n"
)


def mha() -> Seeds:
    import zlib

    raw = values().tobytes()
    plain = _MHD.format(big=True, packed=False, type="MET_USHORT", file="LOCAL").encode() + raw + raw
    return plain, _MHD.format(big=False, packed=True, type="MET_UCHAR", file="LOCAL").encode() + zlib.compress(raw)


def mhd() -> Seeds:
    files = ("a.raw", "LIST\ns001.raw\ns002.raw", "s%03d.raw 1 2 1")
    return tuple(_MHD.format(big=False, packed=False, type="MET_UCHAR", file=file).encode() for file in files)


def tif() -> Seeds:
    import SimpleITK as sitk

    stack = sitk.GetImageFromArray(values().repeat(4, axis=1).repeat(3, axis=2))
    plain = written("a.tif", lambda path: sitk.WriteImage(stack, str(path)))
    packed = written("a.tif", lambda path: sitk.WriteImage(stack, str(path), useCompression=True))
    return plain, packed


# --- surfaces -----------------------------------------------------------------------------------------------------

_CORNERS = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9.0]])
_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def stl() -> Seeds:
    triangles = _CORNERS[_FACES]
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in triangles)
    facet = "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n"
    text = "".join(facet.format("".join("vertex {} {} {}\n".format(*v) for v in triangle)) for triangle in triangles)
    return bytes(80) + struct.pack("<I", 4) + records, f"solid a\n{text}endsolid a\n".encode()


def obj() -> Seeds:
    vertices = "".join("v {} {} {}\n".format(*corner) for corner in _CORNERS)
    faces = "f 1 3 2\nf 1/1 2/1 4/1\nf -4//1 -1//1 -2//1\nf 2 3 4\n"
    return (f"# a\no a\n{vertices}{faces}".encode(),)


def surface_vtk() -> Seeds:
    points = " ".join(f"{value:g}" for value in _CORNERS.ravel())
    faces = "".join("3 {} {} {}\n".format(*face) for face in _FACES)
    head = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n"
    return (f"{head}POINTS 4 float\n{points}\nPOLYGONS 4 16\n{faces}".encode(),)


def surface_vtp() -> Seeds:
    array = '<DataArray type="{}" Name="{}" {} format="ascii">{}</DataArray>'
    points = " ".join(f"{value:g}" for value in _CORNERS.ravel())
    faces = " ".join(map(str, _FACES.ravel()))
    return (
        (
            '<?xml version="1.0"?><VTKFile type="PolyData" version="1.0" byte_order="LittleEndian"><PolyData>'
            '<Piece NumberOfPoints="4" NumberOfPolys="4"><Points>'
            + array.format("Float32", "Points", 'NumberOfComponents="3"', points)
            + f"</Points><Polys>{array.format('Int64', 'connectivity', '', faces)}"
            + f"{array.format('Int64', 'offsets', '', '3 6 9 12')}</Polys></Piece></PolyData></VTKFile>"
        ).encode(),
    )


# --- tables and configurations ------------------------------------------------------------------------------------


def points_csv() -> Seeds:
    return (
        b"x_mm,y_mm,z_mm\n0,0,0\n1,2,3\n4.5,5e0,-6\n",
        b'"x_mm","z_mm","y_mm","name"\r\n0,0,0,a\r\n1,2,3,"b\r\nc"\r\n',
    )


def reference_csv() -> Seeds:
    return (
        b"# A. Author, A title\ngeneration,n_segments,radius_mean_mm,branching_ratio_mean\n1,1,2.5,\n2,2,1.5,0.8\n",
        b"generation,length_mean_mm\n1,10\n",
    )


def toml() -> Seeds:
    return (
        b'method = "cco"\nseed = 1\nn_terminals = 20\nn_connections = 8\ngamma = 3.0\nroot_mm = [0.0, 0.0, 0.0]\n'
        b'terminals_file = "a.csv"\n[domain]\nbox_mm = [9, 7, 5]\n[perfusion]\nroot_pressure_mmhg = 100\n'
        b"terminal_pressure_mmhg = 60.0\nflow_ml_min = 500\n[growth]\nspacing = 0.4\nmerge_mm = 0.1\n"
        b'[geometry]\nsolver = "reduced"\ngamma_by_generation = [3.0, 2.5]\n[topology]\ntests = 1_000\n',
        b'domain.shape = "ball"\nn_terminals = 2\ngamma = 2.5\nmethod = "full"\nviscosity = "fahraeus-lindqvist"\n'
        b"perfusion = { root_pressure_mmhg = 1, terminal_pressure_mmhg = 0, flow_ml_min = 1e-3 }\n",
    )
