"""jaxrelight inverse: what lights or materials make given pictures or measurements; a command for each problem."""

import dataclasses
import sys

from jaxrelight.command_line import run_command
from jaxrelight.commands.dials import HELP_ALL, with_dials
from jaxrelight.commands.inverse_lamps import InverseLampsCommand
from jaxrelight.commands.inverse_light import InverseLightCommand
from jaxrelight.commands.inverse_materials import InverseMaterialsCommand
from jaxrelight.errors import InputError

COMMANDS: dict[str, type] = {
    "light": InverseLightCommand,
    "materials": InverseMaterialsCommand,
    "lamps": InverseLampsCommand,
}


@dataclasses.dataclass(frozen=True)
class Inverse:
    """Solve for light, for materials, or for lamps that meet targets; `jaxrelight inverse --help` says more."""

    def run(self) -> None:
        """Never called: `run_inverse` takes the rest of the command line.

        Raises:
            InputError: always.
        """
        raise InputError("name what is sought: " + ", ".join(COMMANDS))


def run_inverse() -> None:
    """Runs `jaxrelight inverse …`, of whose command line "inverse" is taken away."""
    arguments = sys.argv[2:]
    sys.argv = [sys.argv[0], *("--help" if argument == HELP_ALL else argument for argument in arguments)]
    commands = dict(COMMANDS)
    for name in arguments[:1]:
        if name in commands:
            commands[name] = with_dials(commands[name], arguments)
    run_command(
        "jaxrelight inverse",
        "Solve inverse problems of a known scene.",
        commands,
        "lower --unknowns or the size of the pictures, or use a simpler mesh",
    )
