# SPDX-License-Identifier: Apache-2.0
"""`smallwheel explore`: a local page to set and unset effects in."""

from __future__ import annotations

import os
import signal
import sys
import threading
import webbrowser
from pathlib import Path
from typing import Any

import click

from smallwheel_ros import api
from smallwheel_ros.commands.inputs import (
    DATA,
    MODEL,
    OWN,
    WITHOUT,
    names_of,
    progress_of_steps,
    read_table,
    table_options,
)
from smallwheel_ros.explore import ExploreServer, Session


@click.command("explore", short_help="Set and unset effects in a page, see the error at once.")
@DATA
@MODEL
@OWN
@table_options
@WITHOUT
@click.option("--port", type=click.IntRange(0, 65535), default=0,
              help="Port of the page; any that is free if not given.")  # fmt: skip
@click.option("--no-browser", is_flag=True, help="Only print the address.")
def explore(
    data: Path,
    model_file: Path | None,
    own: Path | None,
    how: dict[str, Any],
    without: str,
    port: int,
    no_browser: bool,
) -> None:
    """Open a page on the measurements in DATA, for this machine only; Ctrl-C ends it.

    The data is diagnosed once. Then set and unset effects: the page shows the model's parameters, its
    held-out error beside that of a true model, and what is left over a setting. Each effect and each pair
    is fitted while you look, any other choice when you make it.
    """
    measurements = read_table(data, how)
    start = api.start_of(measurements, model_file, own, names_of(without))
    with progress_of_steps("diagnosing") as progress:
        session = Session.of(*start, progress)
    for names in session.steps():
        session.view(names)
    with ExploreServer(session, port) as server:
        # A shell starts what runs in the background deaf to Ctrl-C.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            click.echo(server.url)
            click.echo("Ctrl-C ends it.", err=True)
            threading.Thread(target=server.fit_beforehand, daemon=True).start()
            if not no_browser and _has_screen():
                threading.Thread(target=webbrowser.open, args=[server.url], daemon=True).start()
            server.serve_forever()
        except KeyboardInterrupt:
            click.echo("ended", err=True)


def _has_screen() -> bool:
    """Without a screen a browser in the terminal would be opened: not what is wanted."""
    graphic = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return graphic or not sys.platform.startswith("linux")
