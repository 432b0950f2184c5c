"""The command line of the renderer: parsing only."""

import sys

from jaxrelight.command_line import run_command
from jaxrelight.commands.demo import Demo
from jaxrelight.commands.dials import HELP_ALL, with_dials
from jaxrelight.commands.info import Info
from jaxrelight.commands.inverse import Inverse, run_inverse
from jaxrelight.commands.measure import Measure
from jaxrelight.commands.precompute import Precompute
from jaxrelight.commands.relight import Relight
from jaxrelight.commands.render import Render


def main() -> None:
    """Runs `jaxrelight`."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["inverse"]:
        run_inverse()
        return
    commands = {"demo": Demo, "render": Render, "precompute": Precompute, "relight": Relight}
    commands |= {"measure": Measure, "inverse": Inverse, "info": Info}
    for name in arguments[:1]:
        if name in ("render", "precompute", "measure"):
            commands[name] = with_dials(commands[name], arguments)
    sys.argv = ["--help" if argument == HELP_ALL else argument for argument in sys.argv]
    run_command(
        "jaxrelight",
        "Light scenes: from transport that is precomputed once and relit in milliseconds, or with nothing precomputed.",
        commands,
        "lower --width, --height, --resolution or --coefficients, or use a simpler mesh",
    )
