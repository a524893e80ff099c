"""What the paper does not say, and what is assumed instead."""

from __future__ import annotations

from math import degrees

from onebend.studies.manipulation import TASKS
from onebend.studies.outcome import StudyOutcome
from onebend.studies.settings import COLOURED, REVERSAL, STRATEGIES, StudySettings


def assumed(outcome: StudyOutcome) -> list[str]:
    """Sentences on beams, films, pushes, sensor, goals and method."""
    design, fps = outcome.beams[0].design, outcome.setting.fps
    bends = ", ".join(f"{degrees(strategy.bend):.0f} deg ({strategy.says})" for strategy in STRATEGIES)
    turns = " and ".join(f"{degrees(task.turn):.0f} deg ({task.name})" for task in TASKS)
    camera = (
        "filmed from above with 1280 by 720 pixels"
        if outcome.setting.video
        else "whose poses come with a camera's noise, without a picture"
    )
    return [
        f"Beams: {1e3 * design.length:.0f} mm long (Section VI-A), {1e3 * design.depth:.0f} mm deep, silicone of Shore "
        "A 30. Widths, depth and modulus are ours: the paper prints the orders of the widths, the weakest places and "
        "the hardness alone.",
        f"Tags: one of 12 mm on the clamp, three at s = 1/3, 2/3 and 1, {camera}, at {fps:g} frames/s. The film's "
        "start is written down 0.4 s wrong.",
        f"Pushes: at their peaks the pushed place turns by {bends}. The fast push takes 2.5 times less time than the "
        "slow one. The paper prints neither forces nor times.",
        "Force: a Franka's own estimate, noisy and biased (Section VI-B), 80 rows/s, with its white noise, bias, lag "
        f"and lost rows, and {slow_error(outcome)}.",
        f"One robot logs all twelve pushes, so its scale is one: {outcome.gain:.3f} here, drawn once. No force log "
        "reveals it: k(s) comes out as much too large, and errors of k(s) are counted without it. A force is applied "
        "as the same robot reads it.",
        f"Goals of the tasks: places that the true beams can take, their points turned by {turns}. The paper prints "
        "none.",
        "The text of the paper at hand has no rows for Tables I, III and VI; they stay empty.",
        "Both methods see the same observations: clock, tare, filter and scale of the picture are onebend's, not the "
        "paper's nearest rows and millimetres per pixel.",
    ]


def quick_words(setting: StudySettings) -> str:
    """What a quick study leaves out; empty of a whole one."""
    if not setting.quick:
        return ""
    return (
        f"Quick: shorter pushes and {setting.fps:g} frames/s, so its errors are not those that README and "
        "docs/reproduce.md show of the whole run."
    )


def slow_error(outcome: StudyOutcome) -> str:
    """What the slow errors of the force are."""
    if outcome.setting.sensor == "franka":
        return "the slow errors that were measured on such a robot at 3 to 7 N"
    return (
        f"slow errors of {1e3 * COLOURED:.0f} mN (coloured) and {1e3 * REVERSAL:.0f} mN (after each turn of the load), "
        "so large that the true beams under the logged force of a training push are off by about the 2 to 3 mm that "
        "the paper reports"
    )
