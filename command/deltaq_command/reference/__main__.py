"""Write all pages: `python -m deltaq_command.reference`."""

from __future__ import annotations

from deltaq_command.reference import FOLDER, pages


def main() -> None:
    """Write all pages."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
