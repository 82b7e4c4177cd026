"""Words as the viewer can show them: names of recordings, sensors and pairs are in any script.

The viewer has one font, of Latin, Greek and Cyrillic letters and some signs. In its window, whatever else comes is a
box; without a display it panics. Here such characters are escaped, so that names stay different from each other.
"""

import rerun as rr

# What the font has of the blocks that names are in, from its own table: (first, last) code points.
SHOWN_RANGES = (
    (0x20, 0x7E),
    (0xA0, 0x148),
    (0x14A, 0x1C3),
    (0x1C5, 0x31E),
    (0x384, 0x3E1),
    (0x3F0, 0x49D),
    (0x4A0, 0x4FF),
    (0x2010, 0x2027),
    (0x2030, 0x205E),
    (0x2070, 0x208E),
    (0x20A0, 0x20BF),
    (0x2190, 0x2199),
)
SHOWN_SIGNS = frozenset("\n\t✔✓✗▲△⚠−∞√∑∂≈≠≤≥●◆■")


def shown(text: object) -> str:
    """The text with every character that the viewer cannot show as an escape, such as \\u6f22."""
    return "".join(c if _has_glyph(c) else ascii(c)[1:-1] for c in str(text))


def markdown(text: str) -> rr.TextDocument:
    """A page of markdown."""
    return rr.TextDocument(shown(text), media_type=rr.MediaType.MARKDOWN)


def entity_part(name: str) -> str:
    """A name as one part of an entity's path."""
    return rr.escape_entity_path_part(shown(name))


def _has_glyph(c: str) -> bool:
    return c in SHOWN_SIGNS or (c.isprintable() and any(first <= ord(c) <= last for first, last in SHOWN_RANGES))
