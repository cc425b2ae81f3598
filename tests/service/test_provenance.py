"""The revision that logs and AUTOPILOT_VERSION carry is that of our own tree."""

import subprocess
from pathlib import Path

import pytest

from autopilot.run.provenance import revision_of

NOBODY = ("-c", "user.name=nobody", "-c", "user.email=nobody@example.org")


def git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(folder), *NOBODY, *arguments], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def tree(root: Path) -> Path:
    """A folder that looks like ours."""
    (root / "autopilot").mkdir(parents=True)
    (root / "autopilot/__init__.py").write_text("version = 1\n")
    (root / "pyproject.toml").write_text("[project]\n")
    return root


def commit(root: Path) -> str:
    git(root, "init", "-q")
    git(root, "add", "-A")
    git(root, "commit", "-q", "-m", "all")
    return git(root, "rev-parse", "--short=8", "HEAD")


def test_a_clean_checkout(tmp_path: Path) -> None:
    root = tree(tmp_path / "ours")
    head = commit(root)
    assert revision_of(root) == head


@pytest.mark.parametrize("file", ["autopilot/__init__.py", "autopilot/new.py", "pyproject.toml"])
def test_a_changed_checkout_says_so(tmp_path: Path, file: str) -> None:
    root = tree(tmp_path / "ours")
    head = commit(root)
    (root / "notes.txt").write_text("not code")
    assert revision_of(root) == head
    (root / file).write_text("# changed\n")
    assert revision_of(root) == f"{head}-dirty"


@pytest.mark.parametrize("packages", [".venv/lib/python3/site-packages", ".", "vendor/underwater"])
def test_somebody_elses_repository_is_not_ours(tmp_path: Path, packages: str) -> None:
    """Installed into an environment inside a project, into the project's own folder, or copied below it."""
    project = tmp_path / "project"
    root = project / packages
    (root / "autopilot").mkdir(parents=True)
    (project / "their.txt").write_text("theirs")
    (project / ".gitignore").write_text(".venv\nautopilot\n")
    commit(project)
    (root / "autopilot/__init__.py").write_text("")
    assert revision_of(root) == ""
    (root / "pyproject.toml").write_text("[project]\n")
    assert revision_of(root) == ""


def test_a_repository_that_the_environment_names_is_not_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root, other = tree(tmp_path / "ours"), tree(tmp_path / "other")
    commit(other)
    monkeypatch.setenv("GIT_DIR", str(other / ".git"))
    assert revision_of(root) == ""


def test_without_git(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = tree(tmp_path / "ours")
    commit(root)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert revision_of(root) == ""
