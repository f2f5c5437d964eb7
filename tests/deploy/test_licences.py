"""What comes with `deltaq[all]`, or with the arms' closed forms, may be passed on with it, under its licence."""

import re
from importlib.metadata import distribution

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

GOES_WITH_APACHE = (
    r"MIT|BSD|Apache|PSF|Python Software Foundation|ISC|Zlib|BSL-1\.0|HPND|CC0|MPL|Mozilla|LGPL|"
    r"Lesser General Public License|Eclipse Public License|any-OSI"
)
"""Of these LGPL, MPL and EPL bind only who changes the library itself; of any-OSI the user chooses one."""

BOUND = r"(?<!L)GPL|(?<!Lesser )General Public License"
"""Licences that claim what is passed on with them."""

LOOKED_UP = {
    "cmeel-qhull": "says nothing of itself; Qhull's own licence is like BSD's",
    "pyglet": "says nothing of itself; its LICENSE is that of BSD with three clauses",
    "hidapi": "may be used, at the user's choice, under the BSD licence, the GPL or one of its own",
}


DISTRIBUTED = ("deltaq[all]", "EAIK")
"""EAIK by its own name: it is the extra `arms`."""


def closure(*requirements):
    """Names of what an installation of these needs, our own not among them."""
    roots = [Requirement(requirement) for requirement in requirements]
    needed, waiting = {}, [(canonicalize_name(root.name), frozenset(root.extras)) for root in roots]
    while waiting:
        name, wanted = waiting.pop()
        if wanted <= needed.get(name, set()) and name in needed:
            continue
        needed[name] = needed.get(name, set()) | wanted
        for line in distribution(name).requires or []:
            requirement = Requirement(line)
            environments = [default_environment() | {"extra": extra} for extra in (wanted or {""})]
            marker = requirement.marker
            if marker is None or any(marker.evaluate(environment) for environment in environments):
                waiting.append((canonicalize_name(requirement.name), frozenset(requirement.extras)))
    return sorted(set(needed) - {"deltaq"})


def declared(name):
    """The licence by which a distribution declares itself, in short words where it has them."""
    metadata = distribution(name).metadata
    classifiers = [line for line in metadata.get_all("Classifier") or [] if line.startswith("License ::")]
    first_line = (metadata.get("License") or "").strip().splitlines()[:1]
    return metadata.get("License-Expression") or " ".join([*first_line, *classifiers])


@pytest.mark.parametrize("name", closure(*DISTRIBUTED))
def test_every_licence_is_compatible(name):
    licence = declared(name)
    if name in LOOKED_UP:
        assert not licence or re.search(BOUND, licence), f"{name} says {licence} of itself now"
        return
    assert re.search(GOES_WITH_APACHE, licence), f"{name}: {licence or 'declares no licence'}"
    assert not re.search(BOUND, licence), f"{name}: {licence}"
