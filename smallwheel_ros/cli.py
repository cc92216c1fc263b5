# SPDX-License-Identifier: Apache-2.0
"""The command `smallwheel`: one group, its commands imported only when they are used."""

from __future__ import annotations

import errno
import importlib
import os
import sys
from typing import Any

import click

from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.release import __version__

# By name: module and attribute of the command, and its line in `smallwheel --help`.
COMMANDS = {
    "predict": ("commands.physics:predict", "Sinkage, resistance and drawbar pull of a wheel on a soil."),
    "compare": ("commands.bench:compare", "Models on a table, or laws on a folder of data, side by side."),
    "diagnose": ("commands.bench:diagnose", "Find which physical effect a model is missing."),
    "learn": ("commands.bench:learn", "Learn a law that no known effect explains, into a file."),
    "fit": ("commands.bench:fit", "Calibrate soil and effects on measurements, write a model file."),
    "add": ("commands.bench:add", "Add one effect to a model file, see whether the error falls."),
    "report": ("commands.bench:report", "All results for a table in one HTML page."),
    "effects": ("commands.physics:effects", "List the effects, or explain one."),
    "paper": ("commands.physics:paper", "The paper's own numbers, computed and judged."),
    "init": ("commands.init:init", "A rover's parameter file, from a bag, a URDF or a number of wheels."),
    "node": ("ros:node", "The node on the robot, without the command line of ROS."),
    "replay": ("commands.replay:replay", "The node's estimator over recorded drives, without ROS."),
    "simulate": ("simulate.command:simulate", "Data or a drive from the truth simulator."),
    "demo": ("demo.command:demo_command", "Play a simulated drive into the node, draw what it finds."),
    "play": ("demo.command:play_command", "Publish a bag over DDS."),
}  # fmt: skip


class BadInput(click.ClickException):
    """Input of the user that cannot be used: it is printed as one message, with exit code 2."""

    exit_code = 2


def _drop_output() -> None:
    """Discard output that cannot be written: Python would try once more at its exit, and return 120."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class LazyGroup(click.Group):
    """A group that lists its commands from a table and imports each only when it is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the table, which is the order in which a new user needs them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return the command of that name; None if there is none."""
        if cmd_name not in self.list_commands(ctx):
            return None
        module, attribute = COMMANDS[cmd_name][0].split(":")
        command = getattr(importlib.import_module(f"smallwheel_ros.{module}"), attribute)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that the arguments begin with, as click does: its name, itself, and the rest.

        An unknown name ends with a usage error of click that proposes the nearest known one.
        """
        known = self.list_commands(ctx)
        if args and not args[0].startswith("-") and args[0] not in known:
            from smallwheel_ros.common.errors import nearest

            ctx.fail(f"no command '{args[0]}': {nearest(args[0], known)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands from the table, without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in self.list_commands(ctx)])

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; turn an error of the library, or on reading and writing files, into one message."""
        try:
            return super().invoke(ctx)
        except SmallwheelError as error:
            raise BadInput(str(error)) from error
        except OSError as error:
            if error.errno == errno.EPIPE:
                raise  # `| head` has seen enough: click ends quietly
            _drop_output()
            what = f"{error.filename}: " if error.filename else ""
            raise BadInput(f"{what}cannot be read or written: {error.strerror or error}") from error


@click.command(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="smallwheel")
def main() -> None:
    """Terramechanics of small wheels: predict, compare, diagnose, estimate.

    Exit codes: 0 done, 1 a check that you asked for failed, 2 bad input or usage.
    """


if __name__ == "__main__":
    sys.exit(main())
