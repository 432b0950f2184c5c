"""The command line of the renderer: parsing only."""

from jaxrelight.command_line import run_command
from jaxrelight.commands.demo import Demo
from jaxrelight.commands.info import Info
from jaxrelight.commands.precompute import Precompute
from jaxrelight.commands.relight import Relight
from jaxrelight.commands.render import Render


def main() -> None:
    """Runs `jaxrelight`."""
    run_command(
        "jaxrelight",
        "Precompute light transport once; relight under any environment, from any view.",
        (Demo, Render, Precompute, Relight, Info),
        "lower --width, --height, --resolution or --coefficients, or use a simpler mesh",
    )
