"""The twin of a real portal vein."""

from __future__ import annotations

from pathlib import Path

from reports.common.pages import Page, Skipped

TITLE = "The twin of a real portal vein"
FULL: dict[str, object] = {}
SMALL: dict[str, object] = {}


def study(folder: Path) -> Page:
    raise Skipped("vascval twin is not there yet")
