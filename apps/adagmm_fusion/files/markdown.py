"""Names and paths as data in Markdown: what somebody called a folder or a sensor is no table, link or heading."""

from urllib.parse import quote

# What would begin something of its own within a line or a cell of a table.
SIGNS = frozenset("\\`*[]<>|")


def plain(text: str) -> str:
    """The text as Markdown that shows just it: signs escaped, and line ends and other control characters as Python
    writes them."""
    visible = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return "".join(f"\\{c}" if c in SIGNS else c for c in visible)


def link(path: str) -> str:
    """A link to a path that is relative to the page."""
    return f"[{plain(path)}]({quote(path, errors='surrogateescape')})"
