"""Film a beam that is known, and see that the tags are where they truly are."""

import tempfile
from pathlib import Path

import numpy as np

from onebend.lab import FilmRequest, design_named, film, filming_of
from onebend.recording import detect_tags, measure_markers, read_recording

request = FilmRequest(push="s08", seconds=1.5, camera="webcam", fps=6.0, sensor="wrist")
with tempfile.TemporaryDirectory() as place:
    folder = film(filming_of(design_named("linear"), request, "example"), Path(place) / "example", seed=1)
    recording = read_recording(folder)  # as any other; `onebend learn` takes a slower push
    assert recording.video is not None
    seen = measure_markers(detect_tags(recording.video, recording.tags), recording)
    truth = np.load(folder / "truth" / "truth.npz")

off = seen.xy - (truth["tag_xya"][:, 1:, :2] - truth["tag_xya"][:, :1, :2])
print(
    "frames:", len(seen.time), "RMS error of the tags' places [mm]:", round(1e3 * float(np.sqrt(np.nanmean(off**2))), 4)
)
