"""Prints what becomes of a telecommand."""

import sys

from pipelines.mission.sending import Sending
from pipelines.mission.tmtc_messages import Reported, report_words, update_words
from telepresence.tmtc.pus.dictionary import Application


def follow(sending: Sending, application: Application) -> int:
    """Send it, and print what becomes of it; return the exit code."""
    for news in sending.news():
        if isinstance(news, Reported):
            print(report_words(news, application), flush=True)
        else:
            failed = news.done and not news.ok
            print(update_words(news), file=sys.stderr if failed else sys.stdout, flush=True)
    if sending.done is None:
        print("kontur-av: the session has not answered", file=sys.stderr)
    return 0 if sending.done is not None and sending.done.ok else 1
