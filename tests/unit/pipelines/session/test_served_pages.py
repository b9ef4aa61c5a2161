"""The pages' options: addresses are printed and kept, with TLS beyond loopback."""

import json
import stat
import webbrowser
from contextlib import contextmanager

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import make_parser
from pipelines.session import served_pages
from pipelines.session.options import stream_options
from pipelines.session.served_pages import announced_pages, bound_pages, parse_page
from pipelines.session.topology.table import SessionOptions


@contextmanager
def announced(*words):
    args = stream_options(make_parser("stream").parse_args(["stream", *words]))
    with announced_pages(bound_pages(args), "taskboard-1", args, SessionOptions()) as pages:
        yield pages


@pytest.fixture
def root(monkeypatch, tmp_path):
    monkeypatch.setattr(served_pages, "session_root", lambda session: tmp_path)
    return tmp_path


def test_an_address_has_a_host_or_a_port_and_without_pages_nothing_is_said(capsys, root):
    assert parse_page(None)[1] == parse_page("8270")[1] == 8270
    assert parse_page(None)[0].is_loopback
    host, port = parse_page("[::1]:9000")
    assert (host.host, host.address, port) == ("::1", "::1", 9000)
    for wrong in ("", ":8270", "1.2.3.4:", "127.0.0.1:0", "8270:127.0.0.1", "-1", "[::1]:99999"):
        with pytest.raises(ConfigError, match="--page"):
            parse_page(wrong)
    with announced("--no-page") as pages:
        assert not pages
    assert capsys.readouterr().out == "" and list(root.iterdir()) == []


def test_one_address_is_printed_and_all_are_kept_for_the_user_alone(capsys, root):
    with announced() as pages:
        kept = json.loads((root / "pages.json").read_text())
        assert stat.S_IMODE((root / "pages.json").stat().st_mode) == 0o600
        space, ground = pages["page_space"], pages["page_ground"]
        assert kept["pages"] == space.url("")
        assert (kept["space"], kept["ground"]) == (space.url("space"), ground.url("ground"))
        assert kept["k2sv"] == ground.url("k2sv", role="supervisor")
    watch = kept["pages"].partition("token=")[0] + f"token={kept['viewer_token']}"
    printed = [f"pages: {kept['pages']}", f"to watch only: {watch}"]
    assert capsys.readouterr().out.splitlines() == printed
    assert all(page.socket.fileno() == -1 for page in pages.values())
    with announced("-q"):
        assert (root / "pages.json").exists()
    assert capsys.readouterr() == ("", "")


def test_beyond_loopback_a_certificate_is_made_and_without_a_browser_there_is_one_line(
    capsys, root, monkeypatch
):
    with announced("--page", "0.0.0.0:8270") as pages:
        assert pages["page_space"].url("space").startswith("https://")
        assert pages["page_space"].certificate == root / "page.pem"
    assert "SHA-256 " in capsys.readouterr().out

    def none(*_):
        raise webbrowser.Error

    monkeypatch.setattr(webbrowser, "get", none)
    with announced("--open", "-q"):
        pass
    (line,) = capsys.readouterr().err.splitlines()
    assert "no browser" in line


@pytest.mark.rule("10")
def test_no_token_is_an_argument_of_the_browser(monkeypatch, root):
    started = []
    monkeypatch.setattr(webbrowser, "get", lambda: None)
    monkeypatch.setattr(served_pages.subprocess, "Popen", lambda words, **_: started.append(words))
    with announced("--open", "-q") as pages:
        token = pages["page_space"].operator_token
    assert len(started) == 1 and token not in str(started)
    leads = root / "open.html"
    assert token in leads.read_text() and stat.S_IMODE(leads.stat().st_mode) == 0o600
