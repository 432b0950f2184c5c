"""The command line of fits: parsing only."""

from fitting.commands.factors import Factors
from fitting.commands.lafortune import Lafortune
from fitting.commands.sbrdf import Sbrdf
from jaxrelight.command_line import run_command


def main() -> None:
    """Runs `jaxrelight-fit`."""
    run_command(
        "jaxrelight-fit",
        "Fit measured reflectance: data in; lobes, maps or factors, and an account of their error, out.",
        {"lafortune": Lafortune, "factors": Factors, "sbrdf": Sbrdf},
        "lower --resolution or --lobes, or crop the images",
    )
