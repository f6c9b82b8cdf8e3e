"""Vessels as tubes: several views in one figure, with one scale of radii and a scale bar throughout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from reports.common.figures import INK, panels, save
from vascval.core.errors import ComputationError
from vascval.core.tree import Tree
from vascval.report.scene import Tubes, Viewpoint, bounds_mm, scale_bar_mm, tubes, viewpoint
from vascval.report.style import Series
from vascval.report.view import can_render, tube_meshes

RADII_MM = (0.03, 6.0)
"""The scale of colours in every figure: from the thinnest terminals to the stem of a portal vein."""
_PIXELS_PER_INCH = 220


@dataclass(frozen=True, eq=False)
class Layer:
    """A tree in one colour with the words of the legend, or coloured by radius where there is no colour."""

    tree: Tree
    colour: str | None = None
    label: str = ""

    @cached_property
    def tubes(self) -> Tubes:
        return tubes(self.tree, Series(self.label, "tree", self.colour or INK, "o", "-"))


@dataclass(frozen=True, eq=False)
class View:
    """One picture of layers. ``zoom``: its centre in shares of the width and height of the whole, and how many times
    larger it is drawn."""

    title: str
    layers: Sequence[Layer]
    zoom: tuple[float, float, float] | None = None


def write_views(
    folder: Path, views: Sequence[View], *, columns: int, width_in: float = 4.0, name: str = "figure"
) -> None:
    """The views in a grid, all from the same side and, where not zoomed, at the same scale.

    :raises ComputationError: when nothing can be drawn on this machine.
    """
    if not can_render():
        raise ComputationError("VTK cannot draw here; install EGL or OSMesa, or set DISPLAY")
    every = [layer for view in views for layer in view.layers]
    whole = viewpoint(*bounds_mm(None, [layer.tubes for layer in every]))
    height_in = width_in * whole.half_height_mm / whole.half_width_mm + 0.45
    figure, axes = panels(columns, -(-len(views) // columns), width_in=width_in, height_in=height_in)
    figure.get_layout_engine().set(w_pad=0.04, h_pad=0.07, hspace=0.0, wspace=0.02)
    if any(layer.colour is None for layer in every):
        figure.set_figwidth(figure.get_figwidth() + 0.8)
    for view, place in zip(views, axes):
        _draw(place, view, _seen(whole, view.zoom), round(width_in * _PIXELS_PER_INCH))
    for place in axes[len(views) :]:
        place.remove()
    if any(layer.colour is None for layer in every):
        _colour_bar(figure, axes[: len(views)])
    _legend(figure, every)
    save(figure, folder, name)


def _seen(whole: Viewpoint, zoom: tuple[float, float, float] | None) -> Viewpoint:
    if zoom is None:
        return whole
    across, up, times = zoom
    shift = (
        2 * (across - 0.5) * whole.half_width_mm * whole.axes[0] + 2 * (up - 0.5) * whole.half_height_mm * whole.axes[1]
    )
    return replace(
        whole,
        centre_mm=whole.centre_mm + shift,
        half_width_mm=whole.half_width_mm / times,
        half_height_mm=whole.half_height_mm / times,
    )


def _draw(axes: Any, view: View, seen: Viewpoint, width_px: int) -> None:
    half_w, half_h = seen.half_width_mm, seen.half_height_mm
    pixels = _render(view.layers, seen, width_px, round(width_px * half_h / half_w))
    axes.imshow(pixels, extent=(-half_w, half_w, -half_h, half_h), interpolation="antialiased")
    axes.set(xticks=[], yticks=[], title=view.title, xlim=(-half_w, half_w), ylim=(-half_h, half_h))
    axes.grid(False)
    for side in axes.spines.values():
        side.set_visible(view.zoom is not None)
    bar = scale_bar_mm(1.2 * half_w)
    right, below = half_w * 0.98, -half_h * 1.025
    axes.plot((right - bar, right), (below, below), color=INK, linewidth=2.0, clip_on=False, solid_capstyle="butt")
    axes.annotate(
        f"{bar:g} mm", (right - bar / 2, below), xytext=(0, -3), textcoords="offset points", ha="center", va="top",
        fontsize=8.0, annotation_clip=False,
    )  # fmt: skip


def _render(layers: Sequence[Layer], seen: Viewpoint, width_px: int, height_px: int) -> np.ndarray:
    """(height, width, 3) pixels in parallel projection."""
    import pyvista
    from vtkmodules.vtkCommonCore import vtkLogger

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    plotter: Any = pyvista.Plotter(off_screen=True, window_size=[width_px, height_px], lighting="light kit")
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    for layer in layers:
        for mesh in tube_meshes(layer.tubes, 2.0 * seen.half_height_mm / height_px):
            if layer.colour is None:
                plotter.add_mesh(
                    mesh, scalars="radius_mm", cmap=radius_colours(), clim=RADII_MM, log_scale=True,
                    show_scalar_bar=False, ambient=0.25, smooth_shading=True,
                )  # fmt: skip
            else:
                plotter.add_mesh(mesh, color=layer.colour, ambient=0.25, smooth_shading=True)
    back = seen.axes[2]
    plotter.enable_parallel_projection()
    plotter.camera.position = seen.centre_mm + 20.0 * max(seen.half_width_mm, seen.half_height_mm) * back
    plotter.camera.focal_point = seen.centre_mm
    plotter.camera.up = seen.axes[1]
    plotter.camera.parallel_scale = seen.half_height_mm
    plotter.reset_camera_clipping_range()
    pixels = plotter.screenshot(return_img=True)
    plotter.close()
    return np.asarray(pixels)


def radius_colours() -> Any:
    """Orange for thin to black for thick: lightness falls throughout, so that it can be read in grey."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["inferno_r"](np.linspace(0.22, 1.0, 256)))


def _colour_bar(figure: Any, axes: Sequence[Any]) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    bar = figure.colorbar(
        ScalarMappable(LogNorm(*RADII_MM), radius_colours()), ax=list(axes), location="right", aspect=22, pad=0.01,
        shrink=min(0.9, 2.6 / figure.get_figheight()), label="radius (mm)",
    )  # fmt: skip
    ticks = [value for value in (0.03, 0.1, 0.3, 1.0, 3.0) if RADII_MM[0] <= value <= RADII_MM[1]]
    bar.set_ticks(ticks, labels=[f"{value:g}" for value in ticks], minor=False)
    bar.ax.minorticks_off()


def _legend(figure: Any, layers: Sequence[Layer]) -> None:
    from matplotlib.patches import Patch

    named = {layer.label: layer.colour for layer in layers if layer.colour is not None and layer.label}
    if named:
        handles = [Patch(color=colour, label=label) for label, colour in named.items()]
        figure.legend(handles=handles, loc="outside lower left", ncols=len(handles))
