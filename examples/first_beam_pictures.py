"""Draws the pictures of docs/first-beam.md with the commands of that page. `make picture` runs it.

It needs the development environment (`make test` makes it): pypdfium2 turns the sheet of tags into a picture.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import pypdfium2
from PIL import Image

ROOT = Path(__file__).parents[1]
TARGET = ROOT / "docs" / "images"
WIDTH = 720  # px
COMMANDS = (
    "tags --ids 0-3 --size-mm 12 -o {out}/tags.pdf",
    "check examples/linear-beam/train -o {out}/check.png",
    "learn examples/linear-beam/train -o {out}/first-beam --quiet",
    "reach {out}/first-beam --goal 0.1338 0.0638 -o {out}/first-reach",
)


def shrunk(picture: Image.Image, name: str, colours: int = 128) -> None:
    """Keep a picture small enough to be read over a slow line."""
    small = picture.convert("RGB")
    if small.width > WIDTH:
        small = small.resize((WIDTH, round(small.height * WIDTH / small.width)), Image.Resampling.LANCZOS)
    small.quantize(colours).save(TARGET / name, optimize=True)
    print(f"{TARGET / name}: {(TARGET / name).stat().st_size / 1000:.0f} kB")


with tempfile.TemporaryDirectory() as folder:
    for command in COMMANDS:
        words = command.format(out=folder).split()
        subprocess.run([sys.executable, "-m", "onebend", *words], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    out = Path(folder)
    with pypdfium2.PdfDocument(out / "tags.pdf") as sheet:
        page = sheet[0].render(scale=1.8).to_pil()
        shrunk(page.crop((60, 30, 660, 240)), "first-tags.png", 16)
    for source, name in (
        ("check.png", "first-check.png"),
        ("first-beam/figures/stiffness.png", "first-stiffness.png"),
        ("first-beam/figures/fit.png", "first-fit.png"),
        ("first-reach/reach.png", "first-reach.png"),
    ):
        shrunk(Image.open(out / source), name)
