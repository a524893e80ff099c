"""The fit's uncertainty in words and rows: where k(s) is identified, the nuisances, and which parameters trade off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from onebend.beam.profiles.uncertain import IDENTIFIED_SD, UncertainStiffness, half_width
from onebend.learning.criticism.criticism import ALARM_WRITTEN
from onebend.learning.criticism_messages import supposed_words
from onebend.learning.posterior import Nuisance, Posterior
from onebend.learning.tradeoffs import Tradeoff, tradeoffs, with_level
from onebend.learning.verdict import possible
from onebend.recording.signals import runs
from onebend.records import Observations
from onebend.report.findings import Findings
from onebend.report.kinds import is_forced, only_frequencies, only_static
from onebend.report.wording import change_words, millimetres, significant

FACTOR = float(np.exp(half_width(IDENTIFIED_SD)))  # either way: k is identified where it is known to less
SMALL_SHARE = 0.05  # of the largest force: a smaller error under load is not worth a sentence
_PLACES = 401
NARROW = 0.03  # of the beam: a gap between identified stretches that is as wide as the edge of a tag's patch
_SLIVER = 0.01  # of the beam: a shorter identified stretch is not named beside longer ones
_SHOWN = {
    "m": (1e3, "mm"),
    "rad": (180.0 / np.pi, "deg"),
    "m/rad": (1e3, "mm/rad"),
    "s": (1e3, "ms"),
    "1": (1e2, "%"),
    "N": (1e3, "mN"),
    "N/s": (1e3, "mN/s"),
}


@dataclass(frozen=True)
class NuisanceRow:
    """One nuisance, as shown."""

    name: str
    value: str
    before: str  # one sd before the data
    after: str  # one sd after
    unit: str
    moved: float  # |value| in sds before the data
    learned: float  # 1 - after / before: 0 where the data said nothing


def identified_ranges(uncertain: UncertainStiffness) -> list[tuple[float, float]]:
    """First and last s of every stretch where k(s) is identified, to 1/400."""
    s = np.linspace(0.0, 1.0, _PLACES)
    known = uncertain.band(s).identified
    return [(float(s[first]), float(s[end - 1])) for first, end in runs(known)]


def identified_words(ranges: Sequence[tuple[float, float]]) -> str:
    """Where k(s) is identified, as "0.00 to 0.62 (but for 4 % of it), 0.71 to 0.90"; narrow gaps are not named.

    Neither is an identified stretch as short as they are, beside longer ones. `ranges`: at least one.
    """
    joined: list[list[tuple[float, float]]] = []
    for one in ranges:
        if joined and one[0] - joined[-1][-1][1] < NARROW:
            joined[-1].append(one)
        else:
            joined.append([one])
    longest = max(parts[-1][1] - parts[0][0] for parts in joined)
    words = []
    for parts in joined:
        begin, end = parts[0][0], parts[-1][1]
        if end - begin < min(_SLIVER, longest):
            continue
        missing = end - begin - sum(high - low for low, high in parts)
        but = f" (but for {max(100.0 * missing / (end - begin), 1.0):.0f} % of it)" if len(parts) > 1 else ""
        words.append(f"{begin:.2f} to {end:.2f}{but}")
    return ", ".join(words)


def typical_half_width(uncertain: UncertainStiffness) -> float:
    """Half the 95 % band of log k: the median over the identified places; NaN where there is none."""
    ranges = identified_ranges(uncertain)
    if not ranges:
        return float("nan")
    s = np.concatenate([np.linspace(low, high, 51) for low, high in ranges])
    return float(np.median(uncertain.half_width(s)))


def stiffness_range(findings: Findings) -> tuple[float, float]:
    """Smallest and largest k(s) [N m], where it is identified; of all the beam where it is nowhere, or has no band."""
    s = np.linspace(0.0, 1.0, 201)
    k = findings.beam.stiffness(s)
    if findings.posterior is not None:
        known = findings.posterior.band(s).identified
        k = k[known] if known.any() else k
    return float(k.min()), float(k.max())


def unidentified_words(uncertain: UncertainStiffness, recordings: int = 1) -> list[str]:
    """Sentences on where the data do not show k(s); one sentence only where all of k(s) is in doubt."""
    if uncertain.doubts:
        return [f"NOT TO BE TRUSTED: {'; '.join(uncertain.doubts)}. No place of k(s) counts as identified."]
    ranges = identified_ranges(uncertain)
    whose = "this recording says" if recordings == 1 else "these recordings say"
    if not ranges:
        return [f"At no place {whose} enough: k(s) is not known to a factor of {FACTOR:.1f} (95 %) anywhere."]
    rest = f"next to nothing: k is not known to a factor of {FACTOR:.1f} there (95 %)."
    words = []
    if ranges[0][0] > 0.0:
        words.append(f"Nearer to the clamp than s = {np.ceil(100 * ranges[0][0]) / 100:.2f} {whose} {rest}")
    gaps = [(before[1], after[0]) for before, after in pairwise(ranges)]
    words += [f"Between s = {low:.2f} and s = {high:.2f} {whose} {rest}" for low, high in gaps if high - low >= NARROW]
    narrow = [f"{0.5 * (low + high):.2f}" for low, high in gaps if high - low < NARROW]
    if narrow:
        words.append(f"Near s = {', '.join(narrow)}, over less than {NARROW:g} each, {whose} {rest}")
    if ranges[-1][1] < 1.0:
        words.append(f"Beyond s = {ranges[-1][1]:.2f} {whose} {rest}")
    return words


def gain_words(gain_sd: float, *, forced: bool = True) -> str:
    """What the scale error of the force does to k(s), apart from the band's shape."""
    if not forced:
        return "Nothing but its weight bends the beam: the scale of k(s) is that of its weight, m g."
    if gain_sd > 0.0:
        return (
            f"The force's scale is taken as known to {100 * gain_sd:.3g} % (sd; gain_sd in [force]): an error of it "
            "moves all of k(s) alike, by as much, and is in the band."
        )
    return (
        "The force's scale is taken as exact (gain_sd in [force]), and no error of it is in the band: a sensor that "
        "reads 1 % too much makes all of k(s) 1 % too stiff."
    )


def scale_words(gain_sd: float, recordings: Sequence[Observations]) -> str:
    """What the scale of k(s) rests on: the force's, the loads', or the beam's own weight."""
    if only_frequencies(recordings):
        return "Only how fast the beam swings was measured: the scale of k(s) is that of its mass."
    forced = [one for one in recordings if is_forced(one)]
    if not only_static(forced) or not forced:
        return gain_words(gain_sd, forced=bool(forced))
    sd = max(float(np.max(one.force_sd)) for one in forced)
    known = f"known to {significant(1e3 * sd)} mN each (sd; load_sd_N)" if sd > 0.0 else "exact (load_sd_N)"
    return (
        f"The loads are taken as {known}. An error of their common scale is not in the band: a balance that reads 1 % "
        "too much makes all of k(s) 1 % too stiff."
    )


def load_error_words(load_error: tuple[float, float]) -> list[str]:
    """What a force error that comes with the load (sd [N], share of the largest force) does to k(s); empty if small."""
    size, share = load_error
    if share < SMALL_SHARE:
        return []
    return [
        f"The force log seems off by about {size:.2g} N under load ({100 * share:.0f} % of the largest force), by "
        "another amount while it grows than while it falls, which no rest shows. The fit corrects for it; the "
        "uncertainty that remains is in the band. Push harder, or more than once, for a narrower band."
    ]


def stop_words(posterior: Posterior) -> str:
    """Whether the fit converged; where not, why it stopped."""
    steps = f"after {posterior.optimum.steps} steps"
    if posterior.optimum.converged:
        return f"converged {steps}: {posterior.optimum.stopped}"
    return f"did not converge {steps}: {posterior.optimum.stopped}"


def nuisance_rows(nuisances: Sequence[Nuisance]) -> list[NuisanceRow]:
    """Nuisances in mm, degrees, ms, % and mN."""
    rows = []
    for n in nuisances:
        factor, unit = _SHOWN.get(n.unit, (1.0, n.unit))
        rows.append(
            NuisanceRow(
                name=n.name,
                value=f"{significant(factor * n.value, 2)}",
                before=significant(factor * n.prior_sd, 2),
                after=significant(factor * n.sd, 2),
                unit=unit,
                moved=abs(n.value) / n.prior_sd,
                learned=max(1.0 - n.sd / n.prior_sd, 0.0),
            )
        )
    return rows


@dataclass(frozen=True)
class AllowanceRow:
    """One thing that the fit allows for, as shown."""

    name: str
    widening: str  # of the band, as a factor
    change: str  # % of k(s), were it left out; "another" k(s) where it is more than first order tells
    sds: str  # from the ideal bench
    matters: bool


def allowance_rows(posterior: Posterior) -> list[AllowanceRow]:
    """What the fit allows for and what it costs, the largest change of k(s) first."""
    return [
        AllowanceRow(
            name=share.name,
            widening=f"{share.widening:.2f}",
            change=change_words(share.shift),
            sds=f"{share.sds:.1f}",
            matters=share.matters,
        )
        for share in posterior.attributions
    ]


@dataclass(frozen=True)
class ModelTestRow:
    """One test of the fit's model, as shown."""

    what: str
    odds: str  # how often chance alone does as much
    size: str  # mm that it moves a tag by
    shift: str  # % of k
    alarm: bool


def model_test_rows(posterior: Posterior, most: int = 8) -> list[ModelTestRow]:
    """The tests with the smallest p-values; none where the fit is hopeless, as the tests are of small changes."""
    if any(misfit.hopeless for misfit in posterior.misses):
        return []
    critic = possible(posterior).criticism
    return [
        ModelTestRow(
            what=supposed_words(finding, posterior),
            odds=_odds(finding.score.log10_p),
            size=millimetres(finding.score.size),
            shift=f"{100.0 * float(np.expm1(finding.shift)):.2g} %",
            alarm=finding in critic.alarms,
        )
        for finding in critic.able[:most]
    ]


def alarm_words(posterior: Posterior) -> str:
    """The threshold of the tests: among so many, some stand out by chance."""
    critic = possible(posterior).criticism
    written = max(critic.alarm, ALARM_WRITTEN)
    pushed = f" ({_odds(written)} for place and direction of the push, which people write down)"
    return (
        f"Of {len(critic.able)} tests some stand out by chance: one counts as standing out beyond "
        f"{_odds(critic.alarm)}{'' if only_static([one.observations for one in posterior.recordings]) else pushed}, if "
        "k(s) would change by more than half of its sd."
    )


def tradeoff_words(posterior: Posterior) -> list[str]:
    """The strongest pairs, one sentence each; first what the mean of log k(s) depends on."""
    level = with_level(posterior)
    words = [f"{_pair(pair)}" for pair in level]
    return words + [_pair(pair) for pair in tradeoffs(posterior) if pair not in level]


def _pair(pair: Tradeoff) -> str:
    how = "rise and fall together" if pair.correlation > 0.0 else "go against each other"
    return f"{pair.first} and {pair.second} {how} (correlation {pair.correlation:+.2f})"


def _odds(log10_p: float) -> str:
    """A probability as "1 in N", to two digits, down to one in a billion."""
    count = 10.0 ** min(-log10_p, 9.0)
    whole = f"{count:.2g}" if count < 100.0 else f"{float(f'{count:.2g}'):,.0f}".replace(",", " ")
    return f"1 in {whole}" + (" or less" if log10_p < -9.0 else "")
