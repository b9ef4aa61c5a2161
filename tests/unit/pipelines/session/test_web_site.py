"""A site serves its pages' files to those who have a token, and counts those whom it refuses."""

import asyncio
import socket

import aiohttp

from pipelines.session.page_sockets import PageListener
from pipelines.session.web_site import WebSite

PATIENCE_S = 20


def asked(*paths, host=None, words=None):
    """Status, header fields and text of each answer, and what was counted."""

    async def run():
        bound = socket.create_server(("127.0.0.1", 0))
        listener = PageListener(
            socket=bound,
            scheme="http",
            host="127.0.0.1",
            port=bound.getsockname()[1],
            operator_token="operator",
            viewer_token="viewer",
        )
        site = WebSite(listener, seat="space", others=["panel"])

        async def handle(request, found):
            return site.file(request, found, words or {})

        async def close():
            pass

        fields = {} if host is None else {"Host": host}
        found = []
        async with (
            asyncio.timeout(PATIENCE_S),
            site.served("test", handle, close),
            aiohttp.ClientSession() as client,
        ):
            for path in paths:
                url = f"http://127.0.0.1:{listener.port}{path}"
                async with client.get(url, headers=fields) as answer:
                    found.append((answer.status, dict(answer.headers), await answer.text()))
        return found, site.refused

    return asyncio.run(run())


def test_a_page_names_its_files_by_its_own_token_and_they_are_served():
    found, refused = asked("/space?token=viewer", "/viewer/static/space.css", words={"<body": "<B"})
    (status, fields, page), (css_status, css_fields, _) = found
    assert (status, css_status, refused) == (200, 200, {})
    assert '<base href="/viewer/static/" />' in page
    assert "<B" in page
    assert "__BASE__" not in page
    assert page.startswith("<!doctype html>")
    assert '<dialog id="keys"' in page
    assert "#include" not in page
    assert fields["Content-Type"] == "text/html; charset=utf-8"
    assert css_fields["Content-Type"] == "text/css; charset=utf-8"
    assert "default-src 'none'" in fields["Content-Security-Policy"]


def test_strangers_are_refused_and_counted():
    found, refused = asked("/space", "/space?token=x", "/x/static/space.css")
    assert [status for status, _, _ in found] == [403] * 3
    assert refused == {"token": 3}
    found, refused = asked("/space?token=viewer", host="elsewhere.example")
    assert [status for status, _, _ in found] == [403]
    assert refused == {"host": 1}


def test_what_is_no_file_of_a_page_is_not_found():
    found, refused = asked("/viewer/static/none.js", "/viewer/static/jsconfig.json", "/viewer/ws2")
    assert [status for status, _, _ in found] == [404] * 3
    assert refused == {}
