"""Write all pages: `make docs`."""

from reference_pages import FOLDER, PAGES, page


def main() -> None:
    """Write all pages."""
    for name in PAGES:
        (FOLDER / name).write_text(page(name), encoding="utf-8")


if __name__ == "__main__":
    main()
