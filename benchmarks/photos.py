"""Bodies that others photographed: E and bending stiffness from one picture of each under its own weight

The pictures are not part of this project and are read where they lie. Nobody knows the truth: values of makers and
papers stand beside ours.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.pose_folders import DATA, learned, write_table
from onebend.learning.posterior import Posterior
from onebend.learning.verdict import fitted_rms
from onebend.records import Array

# Two silicone cantilevers. The slender part is 0.14 m long, 30 mm wide and thick; a head of 60 mm by 30 mm follows.
BODY, SLENDER, SIDE, MASS = 0.17, 0.14, 0.03, 0.136 + 0.0583  # m, m, m, kg
FRONT = {"mold_star": -0.0025, "ecoflex": -0.0075}  # m, z of the body's front face in the tag's frame
FOCAL, MIDDLE = np.array([904.0, 904.3]), np.array([653.2, 363.3])  # px, of their camera
SCALE = 2000.0  # px/m, of the pictures as seen square to the front face
SEEN = (-0.22, 0.05, -0.22, 0.06)  # m, in the tag's frame: x from, to; y from, to
SILICONE = {
    "mold_star": ("407,190 340,200 250,230 190,262 139,292", "379 kPa", "161 kPa"),
    "ecoflex": ("414,188 350,215 290,265 245,315 202,370", "83 kPa", "65 kPa"),
}  # clicks; the maker's modulus at 100 % strain; the paper's 2 mu (1 + nu) with nu = 0.5
CLAMPS = (0.0, 2.0, 10.0)  # deg, one sd of the clamp's direction

YARN_LINE, YARN = 0.5e-3, 0.045  # kg/m (the maker's); N mm^2 (the paper's; its unit is not stated)
YARN_CLICKS = {
    "10_1.jpg": "6,242 89,280 158,352 232,459 321,871 366,1234 353,1606 331,1971 329,2328 406,2588",
    "10_2.jpg": "6,204 106,250 197,320 269,471 328,816 308,1196 321,1550 343,1899 343,2250 346,2508",
    "10_3.jpg": "6,324 112,382 192,488 270,643 344,909 390,1263 434,1607 463,1952 417,2311 376,2579",
    "15_1.jpg": "6,210 59,245 101,296 133,383 167,876 171,1224 185,1568 177,1914 210,2255 320,2493",
    "15_2.jpg": "6,100 57,134 97,187 126,272 160,751 199,1085 230,1419 197,1762 98,2105 47,2330",
    "15_3.jpg": "6,162 68,190 112,249 144,346 159,796 183,1124 217,1449 197,1781 115,2115 77,2335",
    "20_1.jpg": "6,94 57,139 89,204 117,295 111,695 98,1005 98,1311 108,1616 115,1921 134,2128",
    "20_2.jpg": "6,202 40,229 69,264 84,329 121,852 109,1187 98,1520 86,1851 127,2180 189,2404",
    "20_3.jpg": "6,107 44,141 61,195 77,267 94,695 91,995 79,1294 57,1593 64,1890 71,2089",
    "25_1.jpg": "6,144 30,170 45,203 55,253 77,814 74,1153 77,1490 75,1828 45,2166 20,2391",
    "25_2.jpg": "6,127 31,147 48,177 61,222 65,794 53,1131 43,1466 34,1802 67,2136 138,2360",
}


def squared(name: str) -> Image.Image:
    """The picture as a camera square to the body's front face would show it, by the authors' camera and tag."""
    pose = np.median(np.load(DATA / "photos_bent_silicone" / f"{name}_tag_to_camera.npy"), axis=0)
    left, _, right = np.linalg.svd(pose[:3, :3])
    image = np.asarray(Image.open(DATA / "photos_bent_silicone" / f"{name}.png").convert("RGB"), dtype=float)
    x, y = np.arange(SEEN[0], SEEN[1], 1.0 / SCALE), np.arange(SEEN[3], SEEN[2], -1.0 / SCALE)
    plane = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), FRONT[name])], axis=-1)
    there = plane @ (left @ right).T + pose[:3, 3]
    px = np.clip(there[..., :2] / there[..., 2:] * FOCAL + MIDDLE, 0.0, np.array(image.shape[1::-1]) - 1.01)
    j, i = np.moveaxis(px.astype(int), -1, 0)
    fx, fy = np.moveaxis(px % 1.0, -1, 0)[..., None]
    top, low = (image[row, j] + fx * (image[row, j + 1] - image[row, j]) for row in (i, i + 1))
    return Image.fromarray(np.rint(top + fy * (low - top)).astype(np.uint8))


def photo_folder(folder: Path, image: Path | Image.Image, clicks: str, beam: str, base: float, clamp: float) -> Path:
    """One picture as a user would describe it; the last click may end with its s."""
    (folder / "photos").mkdir(parents=True)
    if isinstance(image, Path):
        shutil.copy(image, folder / "photos" / "photo.jpg")
    else:
        image.save(folder / "photos" / "photo.jpg", quality=100, subsampling=0)
    write_table(folder / "loads.csv", "pose,s,mass_kg", [("photo.jpg", "", "")])
    rows = [(*("photo.jpg", *one.split(",")), "", "")[:4] for one in clicks.split()]
    write_table(folder / "clicks.csv", "pose,x_px,y_px,s", rows)
    (folder / "recording.toml").write_text(
        f'format = 1\n[beam]\n{beam}[photos]\nfolder = "photos"\nloads = "loads.csv"\nclicks = "clicks.csv"\n'
        f"clamp_sd_deg = {clamp}\n[gravity]\ndirection_deg = -90\nbase_angle_deg = {base}\n"
    )
    return folder


def bending(posterior: Posterior) -> tuple[Array, float]:
    """(3,) N m^2: EI near the clamp with its 95 % band; and m, RMS of the curve's misfit."""
    band = posterior.band(np.array([0.3]))
    rms = float(np.sqrt(np.nanmean(np.square(fitted_rms(posterior)[0]))))
    return posterior.recordings[0].observations.length * np.array([band.k[0], band.low[0], band.high[0]]), rms


def silicone(folder: Path) -> None:
    end = SLENDER / BODY
    print(
        "**Silicone cantilevers** (diku-dk/DiffCal, Arnavaz et al. 2023): 0.14 m x 30 mm x 30 mm and a head of\n"
        "0.03 m, seen obliquely beside a tag; the pictures are made square to the front face with the authors'\n"
        "camera and tag. Five clicks each. Section and straightness are stated. So thick a body also shears (about\n"
        "4 % of E here), and it turns in its clamp: the picture shows by how much, if `clamp_sd_deg` leaves it free.\n"
        "The maker's values are of 100 % strain and from memory; the paper's are of a finite element fit to films.\n"
        "They differ by a factor of two, and ours do not decide between them.\n\n"
        "| body | clamp_sd_deg | E [kPa] | 95 % band | misfit, RMS [mm] | data sheet | paper | verdict |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    for name, (clicks, sheet, paper) in SILICONE.items():
        for clamp in CLAMPS:
            here = folder / f"{name}-{clamp:.0f}"
            beam = f'length_m = {BODY}\nmass_kg = {MASS}\nthickness_m = {SIDE}\nsection_file = "section.csv"\n'
            beam += 'mass_along = "section"\nstiffness_along = "section"\nrest = "straight"\n'
            photo_folder(here, squared(name), f"{clicks},{end:.4f}", beam, 180.0, clamp)
            section = [(0, SIDE), (f"{end:.4f}", SIDE), (f"{end:.4f}", 2 * SIDE), (1, 2 * SIDE)]
            write_table(here / "section.csv", "s,width_m", section)
            posterior = learned([here])
            stiffness, rms = bending(posterior)
            k, low, high = 1e-3 * stiffness / (SIDE**4 / 12.0)
            found = f"{k:.0f} | {low:.0f} to {high:.0f} | {1e3 * rms:.2f}"
            print(f"| {name} | {clamp:g} | {found} | {sheet} | {paper} | {posterior.grade} |")


def yarn(folder: Path) -> None:
    print(
        "\n**Acrylic yarn over a ledge** (sabetta/stitch-by-stitch, Singal et al. 2024): eleven pieces, each alone.\n"
        "The length of the overhang is the scale; 0.50 g/m is the maker's, from memory. The yarn's own waves, which\n"
        f"its weight does not pull straight, are left in the misfit. The paper says {YARN} (N mm^2 assumed).\n\n"
        "| piece | overhang [cm] | EI [N mm^2] | 95 % band | misfit, RMS [mm] | verdict |\n"
        "| --- | --- | --- | --- | --- | --- |"
    )
    found = []
    for name, clicks in YARN_CLICKS.items():
        length = float(name[:2]) / 100.0
        beam = f'length_m = {length}\nmass_kg = {YARN_LINE * length}\nmass_along = "even"\nstiffness_along = "even"\n'
        image = DATA / "photos_yarn" / name
        posterior = learned([photo_folder(folder / name[:4], image, clicks, beam, 0.0, 10.0)])
        stiffness, rms = bending(posterior)
        found.append(1e6 * stiffness)
        k, low, high = found[-1]
        values = f"{k:.3f} | {low:.3f} to {high:.3f} | {1e3 * rms:.1f} | {posterior.grade}"
        print(f"| {name[:4]} | {100 * length:.0f} | {values} |")
    every = np.array(found)
    inside = int(np.sum((every[:, 1] < YARN) & (every[:, 2] > YARN)))
    print(f"\nMedian {np.median(every[:, 0]):.3f} N mm^2; the paper's value lies in {inside} of {len(every)} bands.")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        silicone(Path(folder))
        yarn(Path(folder))


if __name__ == "__main__":
    main()
