"""Colours that mean something are told apart by every kind of colour vision; words and signs say the same."""

import re

import pytest
from colour_vision import contrast, nearest
from installed import ROOT

PAGE = ROOT / "services" / "deltaq_services" / "console" / "page"
REPORT = ROOT / "testing" / "deltaq_testing" / "report_page.css"
STATES = ("accent", "good", "warn", "bad", "record")
"""Engaged, ready, braking or offline, held, and a recording."""
TOLD_APART = {"usual": 20.0, "protanopia": 20.0, "deuteranopia": 20.0, "tritanopia": 10.0}


def blocks(path):
    """The custom properties of each `:root` block of a style sheet that are colours, in their order."""
    text = path.read_text(encoding="utf-8")
    found = re.findall(r":root[^{]*\{(.*?)\}", text, re.DOTALL)
    return [dict(re.findall(r"--([\w-]+):\s*(#[0-9a-fA-F]{6})\b", block)) for block in found]


def margins():
    """The colours of the line between the nearest bodies."""
    text = (PAGE / "overlays.js").read_text(encoding="utf-8")
    colours = re.findall(r"#[0-9a-f]{6}", re.search(r"MARGINS = (.*);", text)[1])
    assert len(colours) == 3
    return dict(zip(("near", "middle", "far"), colours, strict=True))


@pytest.mark.parametrize("vision", TOLD_APART)
@pytest.mark.parametrize("look", ["dark", "light"])
def test_colours_of_robot_states_are_distinguishable(look, vision):
    dark, light = blocks(PAGE / "theme.css")
    colours = {"dark": dark, "light": light}[look]
    distance, one, other = nearest({name: colours[name] for name in STATES}, vision)
    assert distance >= TOLD_APART[vision], f"{one} and {other}"


@pytest.mark.parametrize("vision", TOLD_APART)
def test_colours_of_margins_are_distinguishable(vision):
    distance, one, other = nearest(margins(), vision)
    assert distance >= TOLD_APART[vision], f"{one} and {other}"


@pytest.mark.parametrize("vision", TOLD_APART)
@pytest.mark.parametrize("look", [0, 1, 2], ids=["light", "dark", "print"])
def test_colours_of_report_phases_are_distinguishable(look, vision):
    colours = blocks(REPORT)[look]
    phases = {name: colours[name] for name in ("ready", "engaged", "braking", "held", "offline")}
    distance, one, other = nearest(phases, vision)
    assert distance >= TOLD_APART[vision], f"{one} and {other}"


@pytest.mark.parametrize("look", [0, 1], ids=["dark", "light"])
def test_text_in_these_colours_is_readable(look):
    colours = blocks(PAGE / "theme.css")[look]
    for name in (*STATES, "text", "soft"):
        assert contrast(colours[name], colours["panel"]) >= 4.5, name
    assert contrast(colours["record-text"], colours["record"]) >= 7
    assert contrast("#ffffff", colours["stop"]) >= 4.5
