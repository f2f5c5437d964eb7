"""Where the parts of the page are. What is in them is filled in by the modules of `browser/`, by their names."""

from __future__ import annotations

from nicegui import ui

from deltaq_services.console.page.element import CellView

_ICON = (
    '<svg viewBox="0 0 24 24" aria-hidden="true"><path d="M12 3.5 21 20H3z" fill="none" stroke="currentColor" '
    'stroke-width="2.4" stroke-linejoin="round"/></svg>'
)


def lay_out() -> None:
    """Lay out the page of the present client."""
    ui.query(".nicegui-content").classes("console-page")
    with _part("div", "console"):
        _bar()
        with _part("aside", "driving", "panel left").props('aria-label="Driving"'):
            pass
        with ui.element("main").classes("middle"):
            with _part("section", "stage", "stage").props('aria-label="The cell"'):
                CellView().classes("fills")
                _part("div", "views", "views").props('role="toolbar" aria-label="Views"')
                _part("div", "notices", "notices").props('role="status" aria-live="polite"')
                _part("figure", "follower", "follower")
                _part("section", "replay", "replay").props('aria-label="Recording" hidden')
            _part("section", "log", "log").props('aria-label="Events"')
        with _part("aside", "figures", "panel right").props('aria-label="Figures"'):
            pass
        _part("div", "cover", "cover")
        _part("div", "asks", "asks").props('role="alert"')
        _part("section", "library", "library").props('aria-label="Recordings" hidden')


def _bar() -> None:
    """The bar at the top: which cell, whether it is real, how old the picture is, and STOP."""
    with ui.element("header").classes("bar"):
        ui.html(f'{_ICON}<b>deltaq</b><span data-part="cell"></span>', sanitize=False).classes("brand")
        _part("span", "reality", "badge")
        _part("div", "chips", "chips")
        ui.element("span").classes("spring")
        _part("span", "age", "age").props('title="Age of the picture"')
        _part("span", "who", "who")
        with _part("button", "recordings", "plain recordings").props("hidden"):
            pass
        with _part("button", "look", "plain").props('title="Light or dark" aria-label="Light or dark"'):
            pass
        with _part("button", "stop", "stop").props('aria-describedby="stop-answer"'):
            _part("b", "stop-title")
            _part("small", "stop-answer").props('id="stop-answer" role="status" aria-live="assertive"')


def _part(tag: str, name: str, classes: str = "") -> ui.element:
    return ui.element(tag).props(f'data-part="{name}"').classes(classes or name)
