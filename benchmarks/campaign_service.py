"""Trials of campaign_kills.py with a result of their own.

An early SIGINT: status 130, one line, no traceback. A limit of address space: status 2, with the limit and
the need. Half-open connections to `drupe watch`: its page answers, and the fruit are graded.
"""

import http.client
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from typing import Any
from urllib.parse import urlsplit

EARLY = """import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in a shell's background ignores it
import pipeline.start
open({mark!r}, "w").close()
if __name__ == "__main__":
    pipeline.start.main()
"""
TRIES = 5
"""Runs until an interrupt comes before the command's own end."""


def early_interrupt(campaign: Any, after_s: float) -> str:
    """Ctrl-C at a moment after drupe's first line has run: 130, and one line or none."""
    for _ in range(TRIES):
        began = campaign.folder / "began"
        began.unlink(missing_ok=True)
        (campaign.folder / "early.py").write_text(EARLY.format(mark=str(began)))
        run = subprocess.Popen(
            [sys.executable, str(campaign.folder / "early.py"), "check", str(campaign.batch)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        while not began.exists() and run.poll() is None:
            time.sleep(0.001)
        time.sleep(after_s)
        if run.poll() is None:
            run.send_signal(signal.SIGINT)
            status = campaign.wait(run)
            campaign.require(status == 130, f"ended with {status}")
            campaign.require(campaign.said in ("", "drupe: interrupted\n"), "says more than that")
            return "exit 130"
        campaign.wait(run)
    return "ended before the signal"


def little_address_space(campaign: Any, limit_MiB: int, command: list[str]) -> str:
    """A limit below what libraries need: status 2, with the limit and the need."""
    run = subprocess.run(
        [sys.executable, str(campaign.folder / "entry.py"), *command],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit_MiB * 2**20, limit_MiB * 2**20)),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    campaign.said = run.stderr
    expected = (
        rf"drupe: this machine: not enough memory: the limit .* is {limit_MiB} MiB, and about \d+ MiB are"
    )
    campaign.require(run.returncode == 2, f"ended with {run.returncode}")
    campaign.require(re.match(expected, run.stderr) is not None, "does not say what is lacking")
    return "exit 2, limit and need are said"


def half_open(campaign: Any, first_bytes: bytes, connections: int = 1100) -> str:
    """Idle connections, with as many files as a login shell allows: the page answers, fruit are graded."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, most), most))
    out = campaign.folder / "watched"
    shutil.rmtree(out, ignore_errors=True)
    command = [
        sys.executable,
        str(campaign.folder / "entry.py"),
        "watch",
        str(campaign.batch),
        "--out",
        str(out),
    ]
    with (
        subprocess.Popen(
            [*command, "--idle", "0.2", "--settle", "0"],
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (1024, most)),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as run,
        ExitStack() as held,
    ):
        assert run.stdout is not None
        address = urlsplit(run.stdout.readline().removeprefix("page:").strip())
        for _ in range(connections):
            one = held.enter_context(closing(socket.create_connection((address.hostname, address.port), 20)))
            with suppress(ConnectionError):
                one.sendall(first_bytes)
        page = held.enter_context(
            closing(http.client.HTTPConnection(str(address.hostname), address.port, 20))
        )
        page.request("GET", address.path)
        campaign.require(page.getresponse().status == 200, "the page does not answer")
        status = campaign.wait(run)
    campaign.require(status in (0, 4), f"ended with {status}")
    campaign.require_watched(out)
    return "page answers, fruit graded"


def service_trials(campaign: Any) -> list[tuple[str, Callable[[], str]]]:
    """Trials with an expected result of their own."""
    trials: list[tuple[str, Callable[[], str]]] = [
        (f"SIGINT {after_s:g} s after the first line", lambda s=after_s: early_interrupt(campaign, s))
        for after_s in (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.5, 3.0)
    ]
    commands = {
        "grade": ["grade", str(campaign.batch), "--out", str(campaign.folder / "none")],
        "check": ["check", str(campaign.batch)],
        "convert": ["convert", "none.csv", "none.h5"],
    }
    trials += [
        (f"{limit_MiB} MiB for {name}", lambda m=limit_MiB, c=command: little_address_space(campaign, m, c))
        for name, command in commands.items()
        for limit_MiB in (64, 150, 300, 450, *(() if name == "convert" else (900, 1800)))
    ]
    trials += [
        (f"1100 half-open, {first!r:.12}", lambda b=first: half_open(campaign, b))
        for first in (b"", b"GET / HT", b"GET /wrong/ HTTP/1.1\r\nHost: 127.0.0.1\r\n")
    ]
    return trials
