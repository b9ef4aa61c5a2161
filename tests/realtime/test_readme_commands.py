"""The documents' commands in a fresh clone, word for word: set up, run, upgrade, uninstall."""

import json
import os
import re
import shutil
import subprocess

import pytest
from positions import ROOT

#: Protects against a hang; no result of a test depends on it.
TIMEOUT_S = 900


def block_after(document, mark):
    """The first block of commands after `mark` in a document."""
    text = (ROOT / document).read_text(encoding="utf-8").split(mark, 1)[1]
    return re.search(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)[1]


def git(*arguments, cwd):
    identity = ("-c", "user.name=Tests", "-c", "user.email=tests@example.org")
    subprocess.run(["git", *identity, *arguments], cwd=cwd, check=True, capture_output=True)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A repository of this tree as `origin`, and a fresh `clone` of it, in a home of their own."""
    place = tmp_path_factory.mktemp("fresh")
    left_out = (".git", ".venv*", ".*_cache", ".hypothesis", "__pycache__", "node_modules")
    shutil.copytree(ROOT, place / "origin", ignore=shutil.ignore_patterns(*left_out))
    git("init", "-q", "-b", "main", cwd=place / "origin")
    git("add", "-A", cwd=place / "origin")
    git("commit", "-q", "-m", "All", cwd=place / "origin")
    git("clone", "-q", str(place / "origin"), "clone", cwd=place)
    (place / "home").mkdir()
    return place


@pytest.fixture(scope="module")
def shell(place):
    """shell(commands): what a shell in the clone printed; it must end with 0."""
    environment = {**os.environ, "HOME": str(place / "home")}
    for name in ("PYTHONPATH", "VIRTUAL_ENV", "PYTEST_CURRENT_TEST"):
        environment.pop(name, None)

    def run(commands):
        done = subprocess.run(
            ["bash", "-e", "-c", commands],
            cwd=place / "clone",
            env=environment,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
        )
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
        return done.stdout

    return run


@pytest.fixture(scope="module")
def first_run(place, shell):
    """What the README's first command printed."""
    return shell(block_after("README.md", "<!-- command: run -->"))


def test_the_first_command_shows_what_the_readme_promises(first_run, place):
    report = json.loads((place / "clone" / "r.json").read_text())
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    promised = re.findall(r"^\| (\w+) \| \d+ \|", readme, re.MULTILINE)
    assert len(promised) == 6
    for stream in promised:
        assert stream in first_run
    assert "http://" in first_run
    assert report["failures"] == []
    for name, stream in report["streams"].items():
        assert stream["frames_displayed"] > 0, name
    pictures = [*(place / "clone" / "shots").iterdir()]
    assert pictures and all(picture.stat().st_size for picture in pictures)


def test_an_installation_without_extras_has_none_and_says_which_is_lacking(first_run, shell):
    installed = {line.split()[0] for line in shell(".venv/bin/pip list").splitlines()}
    assert "numpy" in installed and not installed & {"pytest", "scipy", "prometheus_client"}
    shell(".venv/bin/kontur-av doctor")
    lacks = shell(
        ".venv/bin/kontur-av stream --setup spacejustin --seconds 1 --metrics 9400 2>&1 || true"
    )
    assert "metrics" in lacks and "Traceback" not in lacks


def test_an_upgrade_brings_the_new_version(first_run, place, shell):
    project = place / "origin" / "pyproject.toml"
    text = project.read_text(encoding="utf-8")
    project.write_text(re.sub(r"^version = .*$", 'version = "9.9.9"', text, flags=re.MULTILINE))
    git("commit", "-q", "-a", "-m", "Next", cwd=place / "origin")
    shell(block_after("docs/install.md", "## Upgrade and uninstall"))
    assert "9.9.9" in shell(".venv/bin/pip show kontur-av")
    shell(".venv/bin/kontur-av doctor")


def test_an_uninstall_leaves_nothing_at_home(first_run, place):
    """The documents say: remove the clone."""
    shutil.rmtree(place / "clone")
    left = [path for path in (place / "home").rglob("*") if path.is_file()]
    assert [path for path in left if "kontur" in str(path).replace(str(place), "")] == []
