"""What the site has beyond the pages: `mkdocs.yml` names this file.

- The navigation follows the lists of `index.md`; a page that they leave out fails the build.
- Each module of `extra.api` has a page, from its docstrings.
- A file of the tree that a page links to, an example say, has a page with its text.
"""

from __future__ import annotations

import json
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

LINK = re.compile(r"(\]\()([^)#:\s]+)((?:#[^)]*)?\))")
SECTION = re.compile(r"^- \*\*(.+?)\*\*:(.*?)(?=^- |^\n|\Z)", re.MULTILINE | re.DOTALL)
LANGUAGES = {
    ".py": "python",
    ".m": "matlab",
    ".cpp": "cpp",
    ".hpp": "cpp",
    ".mjs": "javascript",
    ".yaml": "yaml",
}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Make the navigation."""
    docs = Path(config.docs_dir)
    sections = SECTION.findall((docs / "index.md").read_text(encoding="utf-8"))
    tabs = [{name: [_titled(docs, link) for _, link, _ in LINK.findall(text)]} for name, text in sections]
    config.nav = ["index.md", *tabs, {"Python": [{name: f"api/{name}.md"} for name in config.extra["api"]]}]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is no page of `docs`."""
    for name in config.extra["api"]:
        files.append(File.generated(config, f"api/{name}.md", content=f"# `{name}`\n\n::: {name}\n"))
    root = Path(config.docs_dir).parent
    pages = [file for file in files.documentation_pages() if file.abs_src_path]
    for path in sorted({path for file in pages for path in _linked(file.content_string, file.src_uri)}):
        if (root / path).is_file():  # a dead link stays one, and fails the build
            shown = File.generated(config, f"tree/{path}.md", content=_shown(root, path))
            shown.inclusion = InclusionLevel.NOT_IN_NAV
            files.append(shown)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links to files of the tree lead to their pages."""
    here = page.file.src_uri

    def led(link: re.Match[str]) -> str:
        path = _of_tree(link[2], here)
        if path is None or files.get_file_from_path(f"tree/{path}.md") is None:
            return link[0]
        return f"{link[1]}{posixpath.relpath(f'tree/{path}.md', posixpath.dirname(here))}{link[3]}"

    return LINK.sub(led, markdown)


def _titled(docs: Path, link: str) -> dict[str, str] | str:
    """A page and its heading, which MkDocs does not find behind a comment."""
    page = docs / link
    heading = (
        re.search(r"^# (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE) if page.exists() else None
    )
    return {heading[1].replace("`", ""): link} if heading else link


def _linked(markdown: str, page: str) -> Iterator[str]:
    """Paths of the tree outside `docs` that a page links to."""
    return (path for _, link, _ in LINK.findall(markdown) if (path := _of_tree(link, page)) is not None)


def _of_tree(link: str, page: str) -> str | None:
    """Where in the tree a link of a page leads, if out of `docs`."""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(page), link))
    return path.removeprefix("../") if path.startswith("../") else None


def _shown(root: Path, path: str) -> str:
    if path.endswith(".ipynb"):
        return _shown_notebook(root, path)
    language = LANGUAGES.get(Path(path).suffix, "text")
    return f"# `{path}`\n\n````{language}\n{(root / path).read_text(encoding='utf-8').rstrip()}\n````\n"


def _shown_notebook(root: Path, path: str) -> str:
    """Its text and code, with links as they lead from here."""

    def led(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(path), link[2]))
        page = target.removeprefix("docs/") if target.startswith("docs/") else f"tree/{target}.md"
        return f"{link[1]}{posixpath.relpath(page, posixpath.dirname(f'tree/{path}'))}{link[3]}"

    parts = []
    for cell in json.loads((root / path).read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        parts.append(LINK.sub(led, text) if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    return "\n\n".join([*parts, f"The notebook is `{path}`.", ""])
