"""``vascval skeletonize``."""

from __future__ import annotations

from pathlib import Path

import click

from vascval.cli import sources
from vascval.cli.console import progress, say, write_json
from vascval.cli.options import Selection, json_option, volume_options
from vascval.cli.summary import image_table


@click.command(
    short_help="A volume to a tree",
    epilog="""\b
Examples:
  vascval skeletonize cast.nrrd -o cast.vtp
  vascval skeletonize ct.nii.gz --label 64 -o portal.vtp --json portal.json
  vascval skeletonize microct.mha --threshold auto --root 10.2,4,0 -o cast.vtp
""",
)
@click.argument("volume", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    metavar="TREE.vtp",
    help="The tree; a name in .swc writes SWC instead.",
)
@volume_options
@json_option
def skeletonize(volume: Path, output: Path, selection: Selection, json_file: str | None) -> None:
    """Turn the vessels in VOLUME (NRRD, NIfTI, MetaImage, TIFF, zarr, HDF5) into a tree.

    Vessels are what is not 0, or the voxels chosen by --label or --threshold. The largest connected piece is kept,
    cavities are filled, loops are cut at their thinnest vessel and spurs pruned; what was done is counted in the
    summary. Positions are millimetres in the volume's world frame.
    """
    sources.require(volume, "volume", "a tree needs no skeletonizing; see vascval analyze")
    if output.suffix.lower() not in (".vtp", ".swc"):
        raise click.BadParameter(f"{output} ends in neither .vtp nor .swc", param_hint="-o")
    sources.check_file(output, [volume])
    sources.check_json(json_file, [volume])
    from vascval.io.provenance import provenance
    from vascval.io.trees import write_tree

    origin = provenance(command="skeletonize", config=selection.config(), seed=None, inputs=[volume])
    with progress() as observer:
        skeleton = sources.skeletonize(volume, selection, observer)
    write_tree(skeleton.tree, output, provenance=origin)
    document = {
        "source": volume.name,
        "n_terminals": skeleton.tree.topology.n_terminals,
        "n_segments": skeleton.tree.n_segments,
        "image": skeleton.image,
        "provenance": origin,
    }
    if json_file != "-":
        say(image_table(skeleton.image))
        say(f"\ntree: {output}, {document['n_segments']} segments, {document['n_terminals']} terminals")
    if json_file is not None:
        write_json(document, json_file)
