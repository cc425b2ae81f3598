"""What several modules show on the page."""

from collections.abc import Iterator
from typing import Any

import pytest
from viewers import Run, Stream, run


@pytest.fixture(scope="session")
def events(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What a viewer of a flight hears, until the controller flies."""
    with run(tmp_path_factory.mktemp("page"), "paper-tank", "--start", "--sensors", "pose") as made:
        stream, heard = Stream(made.port), []
        for name, data in stream.events():
            heard.append({"name": name, "data": data})
            if (
                name == "frame"
                and data["control"]
                and data["goal"]
                and len(data["control"]["tube_m"])
                and data["t_s"] > 6
            ):
                break
        made.end()
        return heard


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """A run of the paper's mission, with the page."""
    with run(tmp_path_factory.mktemp("flight"), "paper-tank", "--start", "--sensors", "pose") as made:
        yield made
        made.end()
