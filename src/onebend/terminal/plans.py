"""What `onebend plan` says."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from onebend.learning.design.proposals import Plan, Proposal, direction_words, identified_words
from onebend.report.wording import significant


def plan_table(plan: Plan) -> Table:
    """The proposals of a plan: what costs nothing first."""
    table = Table(
        title="What to do next: what costs nothing first, then by how well k(s) would be known on average",
        title_justify="left",
        box=None,
    )
    for name in ("", "push at s", "force", "to \\[N]", "tip \\[mm]", "needs", "k(s) then"):
        table.add_column(name, justify="left" if name in ("force", "needs") else "right")
    for i, proposal in enumerate(plan.proposals):
        needs = proposal.needs or ("the same once more" if proposal.repeats else "nothing new")
        cells = (
            f"{proposal.push.at_s:.2f}",
            direction_words(proposal.push.direction),
            significant(proposal.push.largest),
        )
        table.add_row(str(i + 1), *cells, f"{1e3 * proposal.tip_moves:.0f}", needs, proposal.after.mean_words)
    return table


def show_plan(console: Console, plan: Plan) -> None:
    """All that `onebend plan` says."""
    before = plan.before
    console.print(
        f"Now k(s) is known to {before.mean_words} (95 %) on average over the whole beam, to {before.worst_words} at "
        "worst "
        f"(s = {before.worst_s:.2f}); {identified_words(before)}.\n",
        highlight=False,
    )
    console.print(plan_table(plan))
    console.print("\n[bold]best:[/]", Text(plan.proposals[0].text))
    console.print("[bold]best two with what there is:[/]", Text(_pair(plan.pair)))
    for reason in plan.left_out:
        console.print(f"[yellow]![/] {escape(reason)}")


def _pair(pair: Sequence[Proposal]) -> str:
    return "; then ".join(proposal.text for proposal in pair)
