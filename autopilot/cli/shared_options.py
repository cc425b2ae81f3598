"""Options shared by several commands."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.click_types import FiniteRange, OneOf
from autopilot.cli.completion import CONFIG_NAME, PARAM_VALUE, SCENARIO_NAME, VEHICLE_NAME
from autopilot.core.errors import ConfigError

if TYPE_CHECKING:
    from autopilot.sitl.camera_process import CameraPlace


def host_and_port(ctx: click.Context, option: click.Parameter, value: str | None) -> tuple[str, int] | None:
    """The two parts of HOST:PORT. ConfigError for another text."""
    if value is None:
        return None
    host, _, port = value.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise ConfigError(f"{option.opts[0]} {value!r}: write HOST:PORT, such as 127.0.0.1:9002")
    return host, int(port)


def not_over(result: Path | None, *sources: Path) -> None:
    """Usage error for a result that would be written over what it is made from."""
    if result is not None and any(
        result.exists() and source.exists() and result.samefile(source) for source in sources
    ):
        raise click.UsageError(f"{result} is what the result comes from, and would be lost; name another file")


def _camera_place(ctx: click.Context, option: click.Parameter, value: str | None) -> "CameraPlace | None":
    from autopilot.sitl.camera_process import CameraPlace

    rest = None if value is None else value.removeprefix("rtp://")
    place = host_and_port(ctx, option, rest)
    return None if place is None else CameraPlace(*place, rtp=rest != value)


JSON = click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")
JSON_NOT_TABLES = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
LOG_FILE = click.argument("log_file", metavar="LOG", type=click.Path(path_type=Path))
SCENARIO_VEHICLE = click.option(
    "--vehicle", type=VEHICLE_NAME, help="Another vehicle than the scenario's: a shipped name or a vehicle file."
)
CONFIG = click.option(
    "--config",
    type=CONFIG_NAME,
    required=True,
    metavar="FILE",
    help="Vehicle configuration: a TOML file, or a shipped name.",
)
INSTANCE = click.option("--instance", type=click.IntRange(0, 99), default=0, show_default=True, help="Instance number.")
SEED = click.option("--seed", type=click.IntRange(min=0), help="Seed of all randomness (default: the scenario's).")
PARAM = click.option(
    "--param", type=PARAM_VALUE, multiple=True, metavar="NAME=VALUE", help="Set a parameter for this run; repeatable."
)
CAMERA = click.option(
    "--camera",
    callback=_camera_place,
    metavar="[rtp://]HOST:PORT",
    help="Where a camera serves pictures of the floor (MJPEG over HTTP), e.g. 127.0.0.1:8090; with rtp:// to where it"
    " sends them (H.264).",
)


def simulated_ardusub(command: Any) -> Any:
    """Arguments of the commands that simulate a vehicle with ArduSub: its water, hull, camera, end and truth."""
    for option in (
        click.option(
            "--truth", type=click.Path(dir_okay=False, path_type=Path), help="File for true poses, a JSON line each."
        ),
        click.option(
            "--duration", type=FiniteRange(min=0.0, min_open=True), help="End after so many simulated seconds."
        ),
        click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True),
        CAMERA,
        click.option("--frame", type=OneOf(["vectored", "vectored_6dof"]), default="vectored", show_default=True),
        click.option(
            "--vehicle",
            type=VEHICLE_NAME,
            default="bluerov2",
            show_default=True,
            help="A shipped vehicle or a vehicle file.",
        ),
        click.argument("scenario", type=SCENARIO_NAME, default="paper-tank"),
    ):
        command = option(command)
    return command


QUIET = click.option("--quiet", is_flag=True, help="Print only errors.")
CAMPAIGN_OUT = click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder of the campaign."
)
CAMPAIGN_PARAM = click.option(
    "--param", type=PARAM_VALUE, multiple=True, metavar="NAME=VALUE", help="Set a parameter in all runs; repeatable."
)
COPY_OUT = click.option(
    "--out", type=click.Path(path_type=Path), help="File to write, or its folder (default: NAME.toml)."
)
ENGINE = click.option("--engine", default="local", show_default=True, help="local, dask or dask+tcp://HOST:PORT.")
JOBS = click.option("--jobs", type=click.IntRange(min=1), help="Runs at a time (default: one per core).")
MARKDOWN_TABLE = click.option("--markdown", is_flag=True, help="As a Markdown table.")
ONLY_TABLE = click.option("--table", "only_table", is_flag=True, help="Fly nothing, print what is there.")
PAPER = click.option(
    "--paper", type=OneOf(("ieee", "elsevier")), help="Width and text of figures in this publisher's papers."
)
COLUMNS = click.option(
    "--columns",
    type=click.IntRange(1, 2),
    default=1,
    show_default=True,
    help="--paper: columns of text that a figure spans.",
)
