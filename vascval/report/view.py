"""Pictures of trees in space: an interactive window, or a file drawn without a display."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.errors import ComputationError
from vascval.core.ordering import strahler_order
from vascval.core.tree import Tree
from vascval.io.atomic import atomic_file
from vascval.report.plots import plain_text
from vascval.report.scene import Surface, Tubes, Viewpoint, bounds_mm, scale_bar_mm, tubes, viewpoint
from vascval.report.style import INK, SURFACE, TREES, Series, rc

_WIDTH, _HEIGHT, _FOOT, _DPI = 1600, 1200, 140, 200
_MOST_BALLS = 4000

_PROBE = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(32, 32))
plotter.set_background("black")
plotter.add_mesh(pyvista.Plane(), color="white", lighting=False)
raise SystemExit(0 if plotter.screenshot(return_img=True).max() > 128 else 3)
"""


def view(tree: Tree, *, screenshot: Path | None = None, surface: Surface | None = None) -> None:
    """Show ``tree`` as tubes of its radii, coloured by Strahler order: in a window, or as a PNG file ``screenshot``.

    A file needs no display: VTK takes an X server, EGL or Mesa's software renderer, whichever there is.

    :raises ComputationError: when nothing can be drawn on this machine.
    """
    layers = _by_order(tree)
    if screenshot is not None:
        write_picture(screenshot, layers, surface=surface)
        return
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ComputationError("no window can be opened here (no display); pass --screenshot FILE.png to draw a file")
    plotter = _plotter(layers, surface, viewpoint(*bounds_mm(surface, layers)), off_screen=False)
    plotter.add_legend_scale()
    plotter.show(title="vascval")


def _by_order(tree: Tree) -> list[Tubes]:
    """The tubes of a tree in layers, one for each Strahler order, the highest first and darkest."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    order = strahler_order(tree.topology)
    highest = int(order[1:].max(initial=0))
    everything = tubes(tree, Series("tree", "tree", *TREES[0]))
    layers = []
    for value in range(highest, 0, -1):
        share = (value - 1) / max(highest - 1, 1)
        look = Series(f"order {value}", "tree", to_hex(colormaps["cividis"](0.85 * (1.0 - share))), "o", "-")
        mine = order[everything.segment] == value
        chosen = {name: getattr(everything, name)[mine] for name in ("start_mm", "end_mm", "radius_mm", "segment")}
        layers.append(replace(everything, series=look, **chosen))
    return layers


@lru_cache(maxsize=1)
def can_render() -> bool:
    """Whether VTK can draw off-screen. Tried in a process of its own: a missing driver may end a process."""
    try:
        done = subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, timeout=120, check=False)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def write_picture(
    path: Path, layers: Sequence[Tubes], *, surface: Surface | None = None, seen: Viewpoint | None = None,
    text: float = 1.0,
) -> str:  # fmt: skip
    """A PNG of the tubes and the translucent surface in parallel projection; returns the view in words.

    ``seen``: from where, if not from the flattest side of what is drawn. ``text``: its size, larger where the picture
    will be shown small.

    :raises ComputationError: when VTK cannot draw on this machine.
    """
    if not can_render():
        raise ComputationError(
            "VTK cannot draw without a display here; install EGL or OSMesa (Debian: libegl1 libgl1-mesa-dri "
            "libosmesa6) with vtk 9.4 or newer, or set DISPLAY"
        )
    seen = seen or viewpoint(*bounds_mm(surface, layers))
    plotter = _plotter(layers, surface, seen, off_screen=True)
    pixels = plotter.screenshot(return_img=True)
    plotter.close()
    figure, axes = _frame(seen)
    half_w, half_h = _shown(seen)
    axes.imshow(pixels, extent=(-half_w, half_w, -half_h, half_h), interpolation="none", aspect="auto")
    _finish(path, figure, axes, layers, surface, text)
    return seen.words


def write_flat_picture(
    path: Path, layers: Sequence[Tubes], *, surface: Surface | None = None, seen: Viewpoint | None = None,
    text: float = 1.0,
) -> str:  # fmt: skip
    """The same picture without VTK: projected tubes of true width, nearest last, and the surface as a shadow."""
    from matplotlib.collections import LineCollection

    seen = seen or viewpoint(*bounds_mm(surface, layers))
    figure, axes = _frame(seen)
    points_per_mm = _HEIGHT / _DPI * 72.0 / (2.0 * _shown(seen)[1])
    if surface is not None:
        flat = (surface.points_mm - seen.centre_mm) @ seen.axes.T
        axes.scatter(flat[:, 0], flat[:, 1], s=1.0, color=SURFACE, alpha=0.25, linewidths=0, rasterized=True)
    for layer in layers:
        start, end = ((p - seen.centre_mm) @ seen.axes.T for p in (layer.start_mm, layer.end_mm))
        near_last = np.argsort(start[:, 2] + end[:, 2], kind="stable")
        start, end, radius = start[near_last, :2], end[near_last, :2], layer.radius_mm[near_last]
        width = np.maximum(2.0 * radius * points_per_mm, 0.3)
        lines = list(np.stack((start, end), axis=1))
        drawn = LineCollection(lines, linewidths=width, colors=layer.series.colour, capstyle="round")
        axes.add_collection(drawn, autolim=False)
    _finish(path, figure, axes, layers, surface, text)
    return seen.words


def _shown(seen: Viewpoint) -> tuple[float, float]:
    """Half width and half height (mm) of the picture: the region to be seen, widened to the picture's shape."""
    half_height = max(seen.half_height_mm, seen.half_width_mm * _HEIGHT / _WIDTH)
    return half_height * _WIDTH / _HEIGHT, half_height


def _plotter(layers: Sequence[Tubes], surface: Surface | None, seen: Viewpoint, *, off_screen: bool) -> Any:
    import pyvista
    from vtkmodules.vtkCommonCore import vtkLogger

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)  # trying one renderer after the other warns each time
    plotter: Any = pyvista.Plotter(off_screen=off_screen, window_size=[_WIDTH, _HEIGHT])
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    _, up, back = seen.axes
    for layer in layers:
        for mesh in tube_meshes(layer, 2.0 * _shown(seen)[1] / _HEIGHT):
            plotter.add_mesh(mesh, color=layer.series.colour, specular=0.15, smooth_shading=True)
    if surface is not None:
        nearer = surface.points_mm + surface.voxel_mm * back
        plotter.enable_depth_peeling()
        mesh = pyvista.PolyData.from_regular_faces(nearer, surface.triangles)
        plotter.add_mesh(mesh, color=SURFACE, opacity=surface.opacity, smooth_shading=True)
    distance = 10.0 * max(_shown(seen))
    plotter.enable_parallel_projection()
    plotter.camera.position = seen.centre_mm + distance * back
    plotter.camera.focal_point = seen.centre_mm
    plotter.camera.up = up
    plotter.camera.parallel_scale = _shown(seen)[1]
    plotter.reset_camera_clipping_range()
    return plotter


def tube_meshes(layer: Tubes, pixel_mm: float) -> list[Any]:
    """The pieces as tubes, with balls at the ends of those thick enough for the gap at a bend to show.

    Meshes of pyvista with ``radius_mm`` at their points; ``pixel_mm`` is the size of a pixel.
    """
    import pyvista

    n = len(layer.radius_mm)
    if n == 0:
        return []
    points = np.stack((layer.start_mm, layer.end_mm), axis=1).reshape(-1, 3)
    cells = np.column_stack((np.full(n, 2), 2 * np.arange(n), 2 * np.arange(n) + 1))
    mesh = pyvista.PolyData(points, lines=cells.ravel())
    mesh["radius_mm"] = np.repeat(layer.radius_mm, 2)
    tube = mesh.tube(scalars="radius_mm", absolute=True, n_sides=16, capping=True)
    thick = slice(0, min(_MOST_BALLS, int(np.count_nonzero(layer.radius_mm > 3.0 * pixel_mm))))  # thickest come first
    if thick.stop == 0:
        return [tube]
    ends = pyvista.PolyData(np.concatenate((layer.start_mm[thick], layer.end_mm[thick])))
    ends["radius_mm"] = np.tile(layer.radius_mm[thick], 2)
    ball = pyvista.Sphere(radius=1.0, theta_resolution=16, phi_resolution=12)
    return [tube, ends.glyph(scale="radius_mm", orient=False, geom=ball)]


def _frame(seen: Viewpoint) -> tuple[Any, Any]:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(rc()):
        figure = Figure(figsize=(_WIDTH / _DPI, (_HEIGHT + _FOOT) / _DPI), dpi=_DPI)
        axes = figure.add_axes((0.0, _FOOT / (_HEIGHT + _FOOT), 1.0, _HEIGHT / (_HEIGHT + _FOOT)))
    half_w, half_h = _shown(seen)
    axes.set(xlim=(-half_w, half_w), ylim=(-half_h, half_h))
    axes.axis("off")
    return figure, axes


def _finish(path: Path, figure: Any, axes: Any, layers: Sequence[Tubes], surface: Surface | None, text: float) -> None:
    """Add a foot with legend and scale bar and write the file."""
    from matplotlib import rc_context
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    left, right = axes.get_xlim()
    bar = scale_bar_mm(right - left)
    x, y = 0.97, 0.4 * _FOOT / (_HEIGHT + _FOOT)
    ends = (x - bar / (right - left), x)
    handles = [Patch(color=layer.series.colour, label=plain_text(layer.series.label)) for layer in layers]
    if surface is not None:
        handles.append(Patch(color=SURFACE, alpha=0.5, label=surface.label))
    with rc_context(rc()), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph .* missing")
        figure.add_artist(Line2D(ends, (y, y), color=INK, linewidth=2.0, solid_capstyle="butt"))
        figure.text(sum(ends) / 2.0, y, f"{bar:g} mm", ha="center", va="bottom", fontsize=8.5 * text, color=INK)
        rows = -(-len(handles) // 4)
        figure.legend(handles=handles, loc="lower left", ncols=-(-len(handles) // rows), fontsize=8.0 * text)
        with atomic_file(path) as temporary:
            figure.savefig(temporary, format="png", metadata={"Software": None})
