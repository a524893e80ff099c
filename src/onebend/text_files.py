"""Text, TOML, JSON and rows of CSV from files of any origin: bounded in size and depth, errors that say what to do.

Whatever stands in a file costs little more memory than the file is long, and ends in data or in the caller's error.
What an error quotes of a file is short, printable, and never from a file that is not a table by its name.
"""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from math import isfinite
from pathlib import Path
from typing import Any, NoReturn

from onebend.errors import OnebendError

MOST_TEXT = 2**26  # bytes of a text that is read as a whole
MOST_TOML = 2**18  # bytes: a description written by hand has some thousand
MOST_TABLE = 2**30  # bytes of a table: ten hours of a log at 1 kHz
MOST_ROWS = 5_000_000  # of a table: more do not fit into memory beside what is made of them
LONGEST_LINE = 100_000  # characters of a table's line
MOST_COLUMNS = 1000
MOST_DOTS = 20  # of one key: tables within tables
QUOTED = 60  # characters that a message quotes of one cell or value
NAMES = 20  # columns that a message lists
TABLES = (".csv", ".txt", ".tsv", ".dat", ".log", ".parquet", ".pq")  # of no other file a message quotes the content
STRINGS = re.compile(r"\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'")
BETWEEN_KEYS = re.compile(r"[,=\[\]{}#]")


def quoted(value: object, most: int = QUOTED) -> str:
    """`value` as Python writes it, printable and on one line, cut short after `most` characters."""
    if isinstance(value, int) and value.bit_length() > 4 * most:
        return f"a number of some {value.bit_length() * 3 // 10} digits"
    if isinstance(value, list | dict) and len(value) > most:
        return f"{'a list' if isinstance(value, list) else 'a table'} of {len(value)} entries"
    shown = ascii_only(repr(value[: 2 * most] if isinstance(value, str | bytes) else value))
    return shown if len(shown) <= most else f"{shown[:most]}..."


def ascii_only(text: str) -> str:
    """`text` with every character that is not printable escaped."""
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in text)


def listed_columns(path: Path, names: Iterable[str]) -> str:
    """The columns of a table, for a message: "found a, b", or "" where the file is no table by its name.

    A description may name any file of the machine; what stands in it is shown only where it is a table.
    """
    if path.resolve().suffix.lower() not in TABLES:
        return ""
    every = [name for name in names if name]
    shown = [ascii_only(name if len(name) <= QUOTED else f"{name[:QUOTED]}...") for name in every[:NAMES]]
    more = f" and {len(every) - NAMES} more" if len(every) > NAMES else ""
    return f"found {', '.join(shown)}{more}" if shown else "found none"


def check_size(path: Path, error: type[OnebendError], most: int) -> None:
    """Raise `error` where `path` is no file, empty, or longer than `most` bytes."""
    try:
        if not path.is_file():
            raise error(f"{path} is not a file. Correct its name, or put the file there.")
        size = path.stat().st_size
    except (OSError, ValueError) as wrong:
        raise error(f"{ascii_only(str(path))} cannot be read: {_reason(wrong)}. Correct its name.") from None
    if size > most:
        raise error(
            f"{path} has {_in_words(size)}; at most {_in_words(most)} are read. Is it the right file? If so, cut out "
            "the part that is needed."
        )
    if size == 0:
        raise error(f"{path} is empty. Write it anew, or correct its name.")


def read_text(path: Path, error: type[OnebendError], *, most: int = MOST_TEXT) -> str:
    """The text of a UTF-8 file, with or without its mark at the beginning.

    Raises `error`: it is no file, empty, cannot be read, longer than `most` bytes, or in another encoding.
    """
    check_size(path, error, most)
    try:
        with path.open("rb") as stream:
            content = stream.read(most + 1)[:most]
        return content.decode("utf-8-sig")
    except OSError as wrong:
        raise error(f"{path} cannot be read: {_reason(wrong)}.") from None
    except UnicodeDecodeError as wrong:
        line = content[: wrong.start].count(b"\n") + 1
        raise error(f"{path}, line {line}, {_encoding_advice(content)}") from None


def read_toml(path: Path, error: type[OnebendError]) -> tuple[str, dict[str, Any]]:
    """Text and data of a TOML file.

    Raises `error`: as `read_text`; it is not valid TOML, or nested deeper than any description is.
    """
    content = read_text(path, error, most=MOST_TOML)
    return content, toml_data(content, path, error)


def toml_data(content: str, path: Path, error: type[OnebendError]) -> dict[str, Any]:
    """Data of a text that is TOML, or is to be: of the file `path`.

    Raises `error`: it is longer than a description is, not valid TOML, or nested deeper.
    """
    if len(content) > MOST_TOML:
        raise error(f"{path} has more than {_in_words(MOST_TOML)}. Is it the right file?")
    for line, row in enumerate(content.splitlines(), start=1):
        if row.count(".") > MOST_DOTS and any(
            part.count(".") > MOST_DOTS for part in BETWEEN_KEYS.split(STRINGS.sub("x", row))
        ):
            raise error(f"{path}, line {line}: a key of more than {MOST_DOTS} parts. Write the tables out.")
    try:
        return tomllib.loads(content)
    except tomllib.TOMLDecodeError as wrong:
        hint = (
            " The file is UTF-16: save it as UTF-8." if "\0" in content[:100] else " Text needs quotes, numbers a dot."
        )
        raise error(f"{path} is not valid TOML: {ascii_only(str(wrong))}.{hint}") from None
    except RecursionError:
        raise error(f"{path} is nested too deeply: lists and tables within each other. Write it flat.") from None
    except ValueError:
        raise error(f"{path} holds a whole number of more digits than any number has. Correct it.") from None


def read_json(path: Path, error: type[OnebendError], advice: str = "Write it anew") -> Any:
    """The data of a JSON file, as its standard has it: no NaN, no infinity. `advice`: what to do about a bad one.

    Raises `error`: as `read_text`; it is not valid JSON, nested too deeply, or holds a number that is none.
    """

    def refuse(constant: str) -> NoReturn:
        raise error(f"{path}: it holds {constant}, which is no number in JSON. {advice}")

    content = read_text(path, error)
    try:
        return json.loads(content, parse_constant=refuse)
    except json.JSONDecodeError as wrong:
        raise error(f"{path}, line {wrong.lineno}: not valid JSON ({wrong.msg}). {advice}") from None
    except RecursionError:
        raise error(f"{path}: nested too deeply. {advice}") from None
    except ValueError:
        raise error(f"{path}: it holds a whole number of more digits than any number has. {advice}") from None


def csv_rows(path: Path, error: type[OnebendError]) -> Iterator[tuple[int, list[str]]]:
    """Line and cells of every row of a CSV file that is not blank, one after the other; the first is the header.

    Raises `error`: it is no file, empty or too long, cannot be read, in another encoding, a line is too long or holds
    too many columns, a quote is not closed, or there are too many rows.
    """
    check_size(path, error, MOST_TABLE)
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(_lines(path, stream, error), skipinitialspace=True)
            filled = (row for row in reader if any(cell and not cell.isspace() for cell in row))
            for count, row in enumerate(filled):
                line = reader.line_num
                if count > MOST_ROWS:
                    raise error(f"{path}, line {line}: at most {MOST_ROWS} rows are read. Cut out what is needed.")
                if len(row) > MOST_COLUMNS:
                    raise error(f"{path}, line {line}: {len(row)} columns; at most {MOST_COLUMNS} are read.")
                if any("\n" in cell or "\r" in cell for cell in row):
                    raise error(f'{path}, line {line}: a quote (") that begins above is not closed in its line.')
                yield line, row
    except UnicodeDecodeError:
        with path.open("rb") as raw:
            head = raw.read(200)
        raise error(f"{path} is not a CSV text file: {_encoding_advice(head)}") from None
    except csv.Error as wrong:
        raise error(f"{path} is not a CSV text file ({wrong}). Export it as CSV with a header.") from None
    except OSError as wrong:
        raise error(f"{path} cannot be read: {_reason(wrong)}.") from None


def _lines(path: Path, stream: Any, error: type[OnebendError]) -> Iterator[str]:
    """The lines of a table, none longer than a table has."""
    count = 0
    while line := stream.readline(LONGEST_LINE):
        count += 1
        if "\0" in line:
            raise error(
                f"{path}, line {count}: bytes that are no text. If the file is UTF-16, save it as UTF-8; else it is "
                "damaged, or no CSV file."
            )
        if len(line) == LONGEST_LINE:
            raise error(f"{path}, line {count}: a line of more than {LONGEST_LINE} characters. Is it a CSV file?")
        yield line


def _encoding_advice(content: bytes) -> str:
    """What to do about bytes that are no UTF-8."""
    wide = content.startswith((b"\xff\xfe", b"\xfe\xff")) or content[:100].count(0) > 20
    return f"it is {'UTF-16' if wide else 'not UTF-8'}. Save it as UTF-8."


def _reason(wrong: OSError | ValueError) -> str:
    return (wrong.strerror if isinstance(wrong, OSError) else None) or str(wrong)


def _in_words(size: int) -> str:
    """5.3 GB, 12 kB."""
    power = min(3, max(0, (len(str(size)) - 1) // 3))
    return f"{size / 1000**power:.3g} {('bytes', 'kB', 'MB', 'GB')[power]}"


# JSON as its standard has it: no NaN and no infinity, and no character that a terminal would act on.

# What JSON lets stand in a string though terminals act on it or no encoding has it. (C0 it escapes by itself.)
_NOT_IN_JSON = re.compile("[\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff]")


def plain(value: Any) -> Any:
    """`value` as JSON knows it: arrays as lists, numbers that are not finite as None."""
    import numpy as np  # here: `--version`, `--help` and most errors need no arrays

    def walked(one: Any) -> Any:
        if isinstance(one, Mapping):
            return {str(key): walked(item) for key, item in one.items()}
        if isinstance(one, np.ndarray) and one.dtype.kind in "fiub" and np.all(np.isfinite(one)):
            return one.tolist()
        if isinstance(one, np.ndarray | list | tuple):
            return [walked(item) for item in one]
        if isinstance(one, np.generic):
            return walked(one.item())
        if isinstance(one, float) and not isfinite(one):
            return None
        return one

    return walked(value)


def to_json(data: Any, *, ascii_only: bool = False, readable: bool = True) -> str:
    """Strict JSON; with `ascii_only` every other character by its code. Not `readable`, it is made much faster."""
    text = json.dumps(plain(data), indent=2 if readable else None, allow_nan=False, ensure_ascii=ascii_only)
    return _NOT_IN_JSON.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


# What a person named (recordings, designs, keys, reasons) is text, wherever it is shown, and nothing else.
#
# A terminal acts on escape sequences, a spreadsheet on cells that begin like a formula, Matplotlib on dollar signs.

# Control characters but the line feed (C0, delete, C1), what turns or hides text (bidirectional marks, zero-width
# signs, line and paragraph separators, tags), and halves of surrogate pairs, which no encoding has.
_NOT_TEXT = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff"
    "\U000e0000-\U000e007f]"
)
_FORMULA = ("=", "+", "-", "@", "\\t", "\\r", "\\n", "|", "%", "＝", "＋", "－", "＠")
LONGEST = 70  # characters of a name in a picture's title


def printable(text: str) -> str:
    """`text` with everything that a terminal or an editor would act on as `\\x1b` and the like; line feeds stay."""
    return _NOT_TEXT.sub(lambda found: _code(found[0]), text)


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
