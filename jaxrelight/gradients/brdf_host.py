"""Entries of `jaxrelight.brdf` that have no derivative: host code, choices and contracts."""

from jaxrelight.gradients.entry import CHOICE, CONTRACT, FILES, HOST, Entries, Exempt, named

ENTRIES: Entries = (
    Exempt(
        (
            *named("jaxrelight.brdf.contract", "Brdf.evaluate Brdf.integral"),
            *named("jaxrelight.brdf.parametrisation", "Parametrisation.place"),
            *named("jaxrelight.brdf.reflection", "Reflection.light_side Reflection.view_side Reflection.view_side_at"),
        ),
        CONTRACT,
    ),
    Exempt(named("jaxrelight.brdf.reflection", "FixedView.view_side"), "always 1: the view is in the light side"),
    Exempt(
        (
            *named("jaxrelight.brdf.bandwidth", "BandwidthTable.look_up CompressedBandwidth.table bandwidth_table"),
            *named("jaxrelight.brdf.bandwidth", "compressed texture_bandwidth"),
        ),
        "bandwidths choose how many samples are taken, not what these are: constant in a cell, always float32",
    ),
    Exempt(
        (
            *named("jaxrelight.brdf.factoring", "Factoring.factors"),
            *named(
                "jaxrelight.brdf.factors",
                "factor factor_error Samples.matrix Samples.times Samples.joined Samples.maps",
            ),
            *named("jaxrelight.brdf.nonnegative", "nonnegative_factors nonnegative_rows"),
            *named("jaxrelight.brdf.singular", "asymmetry largest_singular largest_eigen"),
        ),
        "host code: singular values come in pairs and have no derivative there; see `refactored`, which has",
    ),
    Exempt(
        (
            *named("jaxrelight.brdf.files.content", "Content.array Content.check_finite Content.without_negative"),
            *named("jaxrelight.brdf.files.cornell", "read_pairs read_cornell interpolated"),
            *named("jaxrelight.brdf.files.fitted", "read_fitted read_lobes write_lobes write_factors"),
            *named("jaxrelight.brdf.files.load", "load_brdf"),
            *named("jaxrelight.brdf.files.merl", "read_merl"),
            *named("jaxrelight.brdf.files.rgl", "read_fields read_rgl"),
            *named("jaxrelight.brdf.files.sbrdf", "write_sbrdf read_sbrdf spatial"),
            *named("jaxrelight.brdf.files.spectra", "to_rec709_weights"),
            *named("jaxrelight.brdf.record", "to_record from_record"),
            *named("jaxrelight.brdf.coded", "encode decode"),
        ),
        FILES,
    ),
    Exempt(
        (
            *named("jaxrelight.brdf.albedo", "largest_albedo mean_albedo"),
            *named("jaxrelight.brdf.isotropy", "is_isotropic"),
            *named("jaxrelight.brdf.sub_lobes", "narrower_lobes narrowest is_narrower_than_texels"),
        ),
        CHOICE,
    ),
    Exempt(
        (
            *named("jaxrelight.brdf.bandwidth", "from_square"),
            *named("jaxrelight.brdf.bilinear_warp", "sums"),
            *named("jaxrelight.brdf.pairs", "spread_pairs"),
            *named("jaxrelight.brdf.parametrisation", "Parametrisation.directions Parametrisation.measure"),
            *named("jaxrelight.brdf.parametrisation", "Disc.directions Disc.measure Polar.directions Polar.measure"),
            *named("jaxrelight.brdf.tabulated", "entry_angles least_cosine"),
        ),
        HOST,
    ),
)
