"""The project's studies: commands of ``autopilot bench`` in a source checkout."""

import click

from autopilot.cli.bench_rows import Work, rows_command
from tests.bench import figures_commands as figures
from tests.bench import judged_commands as judged
from tests.bench import replay_commands
from tests.bench.tables import TITLES

COMMANDS: tuple[click.Command, ...] = (
    *(
        figures.estimator,
        figures.energy,
        figures.turns,
        *(rows_command(name, TITLES[name], work) for name, work in figures.ROWS.items()),
    ),
    *(judged.fuzz, judged.sensor_faults, judged.detection, judged.vehicles, judged.kills, judged.soak),
    *(judged.alarms, judged.picture_faults, judged.thruster_health),
    *(replay_commands.replay, replay_commands.reference),
)
AMONG_ALL: dict[str, tuple[str, Work]] = {
    "estimator": (TITLES["estimator"], figures.estimator_rows),
    "pockets": (TITLES["pockets"], figures.pockets_rows),
    "energy": (TITLES["energy"], figures.energy_rows),
    "turns": (TITLES["turns"], figures.turns_rows),
    "energy-latency": (TITLES["energy-latency"], figures.latency_rows),
}
"""Run, short, when no benchmark is named."""
