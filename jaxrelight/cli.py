"""The command line of the renderer: parsing only."""

import sys

from jaxrelight.command_line import run_command
from jaxrelight.commands.demo import Demo
from jaxrelight.commands.dials import ALL_DIALS, chosen_method, with_dials
from jaxrelight.commands.info import Info
from jaxrelight.commands.precompute import Precompute
from jaxrelight.commands.relight import Relight
from jaxrelight.commands.render import RENDERS, Render
from jaxrelight.methods import Transport


def main() -> None:
    """Runs `jaxrelight`."""
    show_all = ALL_DIALS in sys.argv
    sys.argv = ["--help" if argument == ALL_DIALS else argument for argument in sys.argv]
    method = chosen_method(sys.argv[1:])
    # A picture's exposure is that of its error.
    render = with_dials(RENDERS[method.__name__.lower()], method, ["exposure"], show_all, Render.__doc__)
    precompute = with_dials(Precompute, method if method.is_stored else Transport, show_all=show_all)
    run_command(
        "jaxrelight",
        "Precompute light transport once; relight under any environment, from any view.",
        {"demo": Demo, "render": render, "precompute": precompute, "relight": Relight, "info": Info},
        "lower --width, --height, --resolution or --coefficients, or use a simpler mesh",
    )
