"""Adds the page to the console's web application."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI
from nicegui import app as nicegui_app
from nicegui import ui

from deltaq_services.console.page.layout import lay_out
from deltaq_services.console.settings import Settings

_BROWSER = Path(__file__).parent / "browser"
_STYLES = "/console-styles"
_RECONNECT_S = 600.0
"""A page that lost its connection for less than this goes on as it was; it is not loaded again."""


def build(app: FastAPI, settings: Settings) -> None:
    """Serve the console's page at `/`.

    Args:
        app: the console's web application.
        settings: what the console was told when it was started.
    """
    nicegui_app.add_static_files(_STYLES, _BROWSER)
    title = f"deltaq · {Path(settings.cell).stem}"

    @ui.page("/", title=title)
    def page() -> None:
        for sheet in ("theme.css", "layout.css", "parts.css", "ways.css", "replay.css"):
            ui.add_head_html(f'<link rel="stylesheet" href="{_STYLES}/{sheet}">')
        lay_out()

    ui.run_with(app, title=title, reconnect_timeout=_RECONNECT_S, tailwind=False, show_welcome_message=False)
