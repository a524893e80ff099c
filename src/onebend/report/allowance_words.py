"""What the allowances do to k(s), in words: each with its share, and what would narrow the band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onebend.beam.profiles.uncertain import IDENTIFIED_SD, half_width, half_width_words
from onebend.learning.attribution import FORCE_SCALE, SHIFTS, WIDENS, Attribution, hidden_by
from onebend.learning.posterior import Posterior
from onebend.records import GAIN_SD, PLACE_SD, Observations
from onebend.report.wording import ANOTHER, change_words

_MOST_TOLD = 2
_MOST_HIDING = 3


def share_words(share: Attribution) -> str:
    """`relaxation (left out, k(s) would be 9.8 % off)`: what the data show of it, else what it costs."""
    does = []
    if share.sure and share.shift > SHIFTS:
        change = change_words(share.shift)
        does.append(f"left out, {change} k(s)" if change == ANOTHER else f"left out, k(s) would be {change} off")
    if share.widening > WIDENS:
        does.append(f"band {share.widening:.2f} times as wide")
    if not does:
        does.append(f"left out, k(s) might be {change_words(share.size)} off")
    return f"{share.name} ({', '.join(does)})"


def narrower_words(posterior: Posterior) -> str:
    """What would narrow the band, at most two things, and by how many times at most; empty where nothing that a person
    can do would by much."""
    shares = sorted((one for one in posterior.attributions if one.matters), key=lambda one: -one.widening)
    seen = [recording.observations for recording in posterior.recordings]
    every = [(one.widening, what_to_do(one.name, seen)) for one in shares if one.widening > WIDENS]
    told = [f"{what} (up to {widening:.2f} times)" for widening, what in every if what]
    return ", ".join(told[:_MOST_TOLD])


def why_words(posterior: Posterior) -> str:
    """Why k(s) is identified nowhere: what hides it, or that the tags would not tell it were all else known."""
    s, count = np.linspace(0.0, 1.0, 101), sum(len(one.force) for one in posterior.recordings)
    alone, with_one = hidden_by(posterior.problem, posterior.optimum, posterior.gain_sd, s)
    static = all(one.observations.static for one in posterior.recordings)
    told = "one pose does" if static and count == 1 else "the poses do" if static else "the push does"
    if np.min(alone) >= IDENTIFIED_SD:
        more = "bend the beam further, and read the points more exactly" if static else "push further"
        return f"{told} not tell it even were all else known: {more}"
    best = int(np.argmin(alone))
    enough = {name: float(np.min(sd)) for name, sd in with_one.items() if np.min(sd) >= IDENTIFIED_SD}
    each = enough or {name: float(sd[best]) for name, sd in with_one.items() if sd[best] > WIDENS * alone[best]}
    names = sorted(each, key=lambda name: -each[name])[:_MOST_HIDING]
    one = "" if len(names) == 1 else ", each enough to hide it" if enough else ", which hide it together"
    mends = "state more of that, or add poses under other loads" if static else "state more of that"
    return (
        f"{told} not tell it from {', '.join(names)}{one}. Were all else known, k would be known to "
        f"{half_width_words(float(half_width(alone[best])))} at s = {s[best]:.2g}: {mends}"
    )


def mounting_words(posterior: Posterior) -> str:
    """What differs between recordings, and whether the band holds it."""
    if len(posterior.recordings) == 1:
        return "What would differ were the beam mounted anew is not in the band: one recording cannot show it."
    likely, low, high = posterior.mountings
    if np.isnan(likely):
        return ""
    some = f" ({100.0 * low:.2g} to {100.0 * high:.2g} %)" if high > low else ""
    return (
        f"Between the recordings k(s) differs by about {100.0 * likely:.2g} %{some}, one sd: the band is that of the "
        "beam's own k(s), around which each recording has its own."
    )


def what_to_do(name: str, recordings: Sequence[Observations]) -> str:
    """To know more about it; empty where nothing can be done, or where it is stated already."""
    stated = [one.stated for one in recordings]
    by_hand = any(one.place_sd >= PLACE_SD for one in stated)
    uncalibrated = any(one.gain_sd >= GAIN_SD for one in stated)
    ways = {
        "place of the push": ("measure where the push acts: `at_sd_m`", by_hand),
        "stretch and shear": ("measure the thickness: `width_m`", any(np.isnan(one.thickness) for one in stated)),
        "stiff tags": ("thinner tags", True),
        FORCE_SCALE: ("calibrate the sensor with a weight: `gain_sd`", uncalibrated),
        "rest shape": ("measure the beam at rest: `rest_curvature_sd_deg`", True),
    }
    way, is_open = ways.get(name, ("", False))
    return way if is_open else ""
