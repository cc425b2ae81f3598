"""``autopilot log tlog``: attitude regularity in a ground station's file."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path

import click

from autopilot.cli.console_output import EXIT_FAILED, emit_json, print_table
from autopilot.cli.shared_options import JSON


@click.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@JSON
def tlog(file: Path, as_json: bool) -> None:
    """Attitude in a .tlog of any MAVLink vehicle: rate, gaps and their causes, and what the AHRS intake makes of it.

    Exit codes: 0 every gap is explained by what the file shows, 1 not.
    """
    from autopilot.replay.tlog import replay_tlog

    found = replay_tlog(file)
    if as_json:
        emit_json({**asdict(found), "unexplained": len(found.unexplained)})
    else:
        rate = 1.0 / found.median_s if found.median_s else 0.0
        click.echo(
            f"{found.attitudes} attitudes in {found.duration_s:.1f} s, {rate:.1f} Hz;"
            f" {sum(found.damaged.values())} damaged pieces"
        )
        for piece, count in found.damaged.items():
            click.echo(f"  {count} x {piece}")
        copies = Counter(gap.reason(found.median_s) for gap in found.gaps if gap.sender_s == 0.0)
        for reason, count in copies.items():
            click.echo(f"  {count} x {reason}")
        rows = [
            [
                f"{gap.at_s:.2f}",
                f"{gap.arrival_s:.3f}",
                f"{gap.sender_s:.3f}",
                gap.reason(found.median_s) or "not explained",
            ]
            for gap in found.gaps
            if gap.sender_s != 0.0
        ]
        if rows:
            print_table("Gaps between attitudes", ["at s", "arrival s", "sender's clock s", "cause"], rows)
        click.echo(", ".join(f"{name} {count}" for name, count in found.counters.items()))
    if found.unexplained:
        raise click.exceptions.Exit(EXIT_FAILED)
