"""What a person named (recordings, designs, keys, reasons) is text, wherever it is shown, and nothing else.

A terminal acts on escape sequences, a spreadsheet on cells that begin like a formula, Matplotlib on dollar signs.
"""

from __future__ import annotations

import re

# Control characters but the line feed (C0, delete, C1), what turns or hides text (bidirectional marks, zero-width
# signs, line and paragraph separators, tags), and halves of surrogate pairs, which no encoding has.
_ACTING = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff"
    "\U000e0000-\U000e007f]"
)
_FORMULA = ("=", "+", "-", "@", "\\t", "\\r", "\\n", "|", "%", "＝", "＋", "－", "＠")
LONGEST = 70  # characters of a name in a picture's title


def printable(text: str) -> str:
    """`text` with everything that a terminal or an editor would act on as `\\x1b` and the like; line feeds stay."""
    return _ACTING.sub(lambda found: _code(found[0]), text)


def one_line(text: str) -> str:
    """As `printable`, on one line."""
    return printable(text).replace("\n", "\\n")


def csv_cell(value: object) -> object:
    """A cell that no spreadsheet takes for a formula: text that begins like one gets an apostrophe before it."""
    if not isinstance(value, str):
        return value
    text = one_line(value)
    return f"'{text}" if text.lstrip(" \"'").startswith(_FORMULA) and not is_number(text) else text


def figure_text(text: str) -> str:
    """Text for Matplotlib: no mathematics, one line, not longer than a title can be."""
    text = one_line(text)
    if len(text) > LONGEST:
        text = f"{text[: LONGEST - 1]}…"
    return text.replace("$", r"\$")


def _code(letter: str) -> str:
    number = ord(letter)
    if letter in "\t\r":
        return {"\t": "\\t", "\r": "\\r"}[letter]
    return f"\\x{number:02x}" if number < 0x100 else f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def is_number(text: str) -> bool:
    """Whether a table's reader takes the text for a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
