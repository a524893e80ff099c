"""Draws docs/images/learned.jpg: the fit over the video frame, and k(s). `make picture` runs it."""

from io import BytesIO
from pathlib import Path

from PIL import Image

import onebend
from onebend.learning.verdict import explained
from onebend.recording.video import KeptFrames
from onebend.report.figures import Shown, fit, stiffness
from onebend.report.style import png_of

HERE = Path(__file__).parent
TARGET = HERE.parent / "docs" / "images" / "learned.jpg"
HEIGHT = 560  # px

observations = onebend.observe(HERE / "linear-beam" / "train")
learned = onebend.learning.regress(observations)
found = onebend.fit([observations], learned.beam.stiffness)

figures = [
    fit(Shown(found.beam, onebend.validate(found.beam, observations), observations, explained(found)[0]), KeptFrames()),
    stiffness(
        found.beam,
        uncertain=found.stiffness,
        regression=learned.beam.stiffness,
        tags=dict(zip(observations.tag_id.tolist(), observations.marker_s.tolist(), strict=True)),
    ),
]
pictures = [Image.open(BytesIO(png_of(figure))).convert("RGB") for figure in figures if figure is not None]
columns = [one.resize((round(one.width * HEIGHT / one.height), HEIGHT), Image.Resampling.LANCZOS) for one in pictures]

sheet = Image.new("RGB", (sum(column.width for column in columns), HEIGHT), "white")
left = 0
for column in columns:
    sheet.paste(column, (left, 0))
    left += column.width

TARGET.parent.mkdir(parents=True, exist_ok=True)
sheet.save(TARGET, quality=88, optimize=True)
print(f"{TARGET}: {TARGET.stat().st_size / 1000:.0f} kB")
