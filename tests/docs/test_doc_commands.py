"""Command lines of the documentation are accepted by the program; blocks that are marked are run."""

import functools
import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from md_pages import PAGES, ROOT, Block, blocks, command_lines

from autopilot.cli.main import cli, run
from autopilot.run.children import autopilot_command


def _given(value: str) -> bool:
    """A value, not a word that stands for one (FILE, $set, X,Y,R)."""
    return value.upper() != value or value.replace(".", "").lstrip("-").isdecimal()


def accept(arguments: list[str]) -> None:
    """UsageError, unless commands, options and their values are understood; files need not be there."""
    command: click.Command = cli
    context = click.Context(cli, info_name="autopilot")
    rest = arguments
    while isinstance(command, click.Group):
        if not rest and not command.invoke_without_command:
            return  # the name of a group alone
        context = command.make_context(context.info_name, list(rest), parent=context.parent)
        rest = [*context._protected_args, *context.args]
        if not rest or not _given(rest[0]):
            return
        name, found, rest = command.resolve_command(context, rest)
        assert found is not None and name is not None
        command, context = found, click.Context(found, info_name=name, parent=context)
    values, left, _ = command.make_parser(context).parse_args(list(rest))
    if left:
        raise click.UsageError(f"{' '.join(left)} is too much for {context.command_path}")
    for parameter in command.params:
        value = values.get(parameter.name or "")
        if isinstance(parameter.type, (click.Choice, click.IntRange, click.FloatRange)):
            for each in value if isinstance(value, (list, tuple)) else [value]:
                if isinstance(each, str) and _given(each):
                    parameter.type.convert(each, parameter, context)


def refused(page: Path) -> list[str]:
    """What the program does not understand of a page."""
    wrong = []
    for line in command_lines(page):
        try:
            accept(shlex.split(line))
        except (click.exceptions.NoArgsIsHelpError, click.exceptions.Exit):
            continue  # help, the version
        except click.ClickException as error:
            wrong.append(f"autopilot {line}: {error.format_message()}")
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_command_lines_are_understood(page: Path) -> None:
    wrong = refused(page)
    assert not wrong, "\n".join(wrong)


def test_lines_are_found() -> None:
    lines = {page.name: list(command_lines(page)) for page in PAGES}
    assert "mission download FILE --connect udpout:127.0.0.1:14540" in lines["mavlink.md"]
    assert "calibrate flight LOG --out NEW.toml" in lines["calibration.md"]
    assert sum(map(len, lines.values())) > 150


def test_what_the_program_does_not_know_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    good = (
        "`autopilot sitl|run --view [PORT]`\n```\nautopilot sitl pool --sensors pose \\\n    --speed 0  # --no\n```\n"
    )
    page.write_text(good)
    assert refused(page) == []
    for bad in ("sitl --sped 1", "sitl --speed fast", "sitl --sensors poses", "sitl a b", "flie", "log chek LOG"):
        page.write_text(f"`autopilot {bad}`")
        assert len(refused(page)) == 1, bad
        blocks.cache_clear()


TESTED = [block for page in PAGES for block in blocks(page) if block.tested]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where blocks are run: a checkout's files and the log of a flight of some seconds."""
    made = tmp_path_factory.mktemp("blocks")
    for name in ("docs", "sitl"):
        (made / name).symlink_to(ROOT / name)
    (made / "out" / "demo").mkdir(parents=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made)
        patch.setenv("AUTOPILOT_STATE_DIR", str(made / "state"))
        patch.setenv("AUTOPILOT_LOG_DIR", str(made / "logs"))
        flight = "sitl --start --sensors pose --speed 0 --duration 6 --quiet --connect udpout:127.0.0.1:9"
        done = subprocess.run(autopilot_command(*flight.split(), "--log", "out/demo/run.mcap"), check=False)
        assert done.returncode == 0
        yield made


@pytest.mark.parametrize("block", TESTED, ids=lambda block: block.name)
def test_marked_blocks_run(block: Block, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Exit code 0; a log of some seconds may lack laps, which `log check` says by 1."""
    if block.language == "python":
        exec(compile(block.text, block.name, "exec"), {})
        return
    for line in block.commands:
        program, *arguments = shlex.split(line)
        assert program == "autopilot", line
        code = run(functools.partial(cli, arguments, prog_name="autopilot", standalone_mode=False))
        assert code in ((0, 1) if arguments[:2] == ["log", "check"] else (0,)), (line, capfd.readouterr())


def test_blocks_are_marked() -> None:
    assert {block.page.name for block in TESTED} >= {"first-hour.md", "vehicles.md", "own-tank.md", "log.md"}
