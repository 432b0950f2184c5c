"""Entries of `jaxrelight.inverse`: light and materials that are solved for; lamps are in `inverse_lamps`."""

from jaxrelight.gradients.entry import Entries, Exempt, named

ENTRIES: Entries = (
    Exempt(
        (
            *named("jaxrelight.inverse.bidiagonalisation", "Bidiagonal.matrix Bidiagonal.gradient Bidiagonal.mixed"),
            *named("jaxrelight.inverse.bidiagonalisation", "begin step"),
            *named("jaxrelight.inverse.environment", "InverseLight.lights InverseLight.estimate environment"),
            *named("jaxrelight.inverse.light_certainty", "LightCertainty.texel_shares"),
            *named("jaxrelight.inverse.light_certainty", "LightCertainty.texel_deviations LightCertainty.details"),
            *named("jaxrelight.inverse.light_certainty", "LightCertainty.of_mean certainty_of is_seen"),
            *named("jaxrelight.inverse.light_grid", "LightGrid.spectrum LightGrid.solid_angles"),
            *named("jaxrelight.inverse.light_grid", "LightGrid.directions LightGrid.texels LightGrid.pixels"),
            *named("jaxrelight.inverse.light_grid", "LightGrid.on_grid light_grid"),
            *named("jaxrelight.inverse.light_problem", "LightProblem.split rendered applied adjoint right_side"),
            *named("jaxrelight.inverse.light_problem", "weights_of"),
            *named("jaxrelight.inverse.light_report", "write_light_report"),
            *named("jaxrelight.inverse.light_solve", "spectrum_of ridge_weights constrained is_converged"),
            *named("jaxrelight.inverse.material_certainty", "Estimate.width certainty_of_few certainty_of_many"),
            *named("jaxrelight.inverse.material_certainty", "is_ambiguous"),
            *named("jaxrelight.inverse.material_fit", "Scene.rendered Problem.misfit Problem.roughness rendered"),
            *named("jaxrelight.inverse.material_fit", "jacobian search solve_many curvature_at"),
            *named("jaxrelight.inverse.material_unknowns", "Unknown.lobes Unknown.weight Parameter.values"),
            *named("jaxrelight.inverse.material_unknowns", "Unknowns.start Unknowns.materials unknowns_of"),
            *named("jaxrelight.inverse.materials", "materials"),
            *named("jaxrelight.inverse.observations", "Observed.misfit Observed.rendered observe relative_residual"),
        ),
        "solves through light, shade and their adjoints: a solution has no derivative, but tells what is determined; "
        "parts of the solvers are tested where they are",
    ),
)
