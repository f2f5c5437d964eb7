"""Text of XML files in whatever encoding they declare (XML 1.0, 2.11, 4.3.3 and appendix F)."""

import codecs
import re

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),  # before UTF-16's, with which it begins
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_WITHOUT_MARK = ((b"<\0", "utf-16-le"), (b"\0<", "utf-16-be"))
_DECLARED = re.compile(rb"""<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z][A-Za-z0-9._-]*)["']""")
_DECLARATION = re.compile(r"""(<\?xml[^>]*?)\s+encoding\s*=\s*["'](?!(?i:utf-?8)["'])[^"'>]*["']""")


def xml_text(data: bytes) -> str:
    r"""The text of an XML file, as UTF-8 would have it: no byte order mark, no other encoding declared.

    The byte order mark decides, then the declaration; without both it is UTF-8.

    Raises:
        ValueError: the encoding is unknown, or the bytes are not in it.

    >>> xml_text(b'<?xml version="1.0" encoding="ISO-8859-1"?><robot name="f\xfcnf"/>')
    '<?xml version="1.0"?><robot name="fünf"/>'
    """
    mark, encoding = next(((mark, name) for mark, name in _MARKS if data.startswith(mark)), (b"", ""))
    if not encoding:
        encoding = next((name for start, name in _WITHOUT_MARK if data.startswith(start)), "")
    if not encoding:
        declared = _DECLARED.match(data)
        encoding = declared[1].decode("ascii") if declared else "utf-8"
    try:
        text = data[len(mark) :].decode(encoding)
    except LookupError:
        raise ValueError(f"its encoding {encoding!r} is unknown; save it as UTF-8") from None
    except UnicodeError as error:
        raise ValueError(f"it is not {encoding} text ({error}); save it as UTF-8") from None
    return _DECLARATION.sub(r"\1", text.replace("\r\n", "\n").replace("\r", "\n"), count=1)
