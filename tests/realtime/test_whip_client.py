"""A WHIP client goes where servers send it, tells its token to few, and shows what they say."""

import asyncio
from contextlib import asynccontextmanager, suppress

import pytest
from aiohttp import web

from kontur_av.errors import ConfigError, ProtocolError
from pipelines.partner.whip import WhipClient

ANSWER = "v=0\r\ns=Übung\r\n"


@asynccontextmanager
async def serving(answer):
    """A server on a port of its own; its address, and what it was asked: (method, path, token)."""
    asked = []

    async def handle(request):
        asked.append((request.method, request.path, request.headers.get("Authorization", "")))
        return answer(request)

    application = web.Application()
    application.router.add_route("*", "/{path:.*}", handle)
    runner = web.AppRunner(application)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    try:
        yield f"http://127.0.0.1:{runner.addresses[0][1]}", asked
    finally:
        await runner.cleanup()


def created(request, *, location="session/1", charset="utf-8"):
    if request.method != "POST":
        return web.Response(status=200)
    return web.Response(
        status=201,
        body=ANSWER.encode("latin-1" if charset == "latin-1" else "utf-8"),
        headers={"Content-Type": f"application/sdp; charset={charset}", "Location": location},
    )


async def posted(url, **options):
    """Post an offer and return the answer."""
    async with WhipClient(url, **options) as client:
        return await client.post("v=0")


@pytest.mark.parametrize("allowed", [True, False])
@pytest.mark.parametrize("location", ["session/1", "/room/session/1"])
async def test_a_redirect_to_another_origin_is_followed_and_the_session_is_there(allowed, location):
    async with serving(lambda request: created(request, location=location)) as (there, asked):
        moved = {"Location": f"{there}/room/whip"}
        async with serving(lambda _: web.Response(status=307, headers=moved)) as (here, first):
            origins = [there] if allowed else []
            async with WhipClient(f"{here}/a", token="T", token_origins=origins) as client:
                assert await client.post("v=0") == ANSWER
    token = "Bearer T" if allowed else ""
    assert first == [("POST", "/a", "Bearer T")]
    assert asked == [
        ("POST", "/room/whip", token),
        ("DELETE", "/room/session/1", token),
    ]


@pytest.mark.parametrize("location", ["http://[", "//[::1", "http://host:port/x", "mailto:a@b"])
async def test_a_location_that_is_no_address_ends_in_one_line(location):
    async with serving(lambda request: created(request, location=location)) as (url, _):
        with suppress(ProtocolError):
            assert await posted(url, token="T") == ANSWER
    moved = {"Location": location}
    async with serving(lambda _: web.Response(status=307, headers=moved)) as (url, _):
        with pytest.raises((ConfigError, ConnectionError, ProtocolError)):
            await posted(url)


async def test_redirects_are_bounded():
    moved = {"Location": "again"}
    async with serving(lambda _: web.Response(status=307, headers=moved)) as (url, asked):
        with pytest.raises(ProtocolError, match="in circles"):
            await posted(url, token="T")
    assert len(asked) < 10 and {token for *_, token in asked} == {"Bearer T"}


@pytest.mark.parametrize("charset", ["utf-8", "latin-1", "klingon"])
async def test_an_answer_in_any_charset_is_read(charset):
    async with serving(lambda request: created(request, charset=charset)) as (url, _):
        assert await posted(url) == ANSWER


def test_an_answer_of_an_older_server_is_taken_if_it_is_one_and_tried_again_if_it_is_nonsense():
    async def run(body, status, kind):
        def answer(_):
            return web.Response(status=status, text=body, content_type=kind)

        async with serving(answer) as (url, _):
            return await posted(url)

    for status, kind in ((200, "application/sdp"), (202, "text/plain"), (200, "application/json")):
        assert asyncio.run(run(ANSWER, status, kind)) == ANSWER
        with pytest.raises(ProtocolError, match="no session description"):
            asyncio.run(run('{"code": 0}', status, kind))


@pytest.mark.parametrize(
    ("status", "body", "error", "shown"),
    [
        (400, b"only\r\nVP8 here", ConfigError, "only VP8 here"),
        (406, b"\xff\x1b[31m" + b"x" * 999, ConfigError, "xxx"),
        (406, b"", ConfigError, "406"),
        # These are tried again.
        *((code, b"", ConnectionError, str(code)) for code in (409, 429, 500, 503)),
    ],
)
async def test_what_a_server_says_with_a_refusal_is_shown_in_one_line(status, body, error, shown):
    async with serving(lambda _: web.Response(status=status, body=body)) as (url, _):
        with pytest.raises(error, match=shown) as refused:
            await posted(url)
    line = str(refused.value)
    assert line.isprintable() and str(status) in line and len(line) < 300
