"""The one custom element of the page: it brings the modules of `browser/` and three.js, and starts them."""

from __future__ import annotations

from nicegui.element import Element
from nicegui.elements import scene  # its import puts three.js into the page's import map, as `nicegui-scene`

THREE_MODULE = scene.__name__
"""Where three.js comes from."""


class CellView(Element, component="cell_view.js", esm={"deltaq-console": "browser"}):
    """The cell in three dimensions, and all that is live about it; it fills the parts of the page by their names."""
