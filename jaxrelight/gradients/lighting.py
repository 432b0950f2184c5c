"""Entries of `jaxrelight.lighting`: the parts that methods share, and what is host code; see `relighting`."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import numpy as np

from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.gradients.entry import CHOICE, CONTRACT, HOST, RAYS, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import OMEGA_I, OMEGA_O, numbers, two_lobes
from jaxrelight.lighting import antialiasing, contract, measurement
from jaxrelight.lighting.adaptive import view as adaptive_view
from jaxrelight.lighting.filtered_lobes import lobe_radiance
from jaxrelight.lighting.pixels import assembled

_COVERED = np.array([[True, False, True, True], [False, True, True, False]])
_SAMPLES = (
    "predicts noise and bandwidth, which choose where samples are taken and how many, not what these are: sample plans "
    "are held fixed"
)
_ERRORS = "host code: measures or bounds errors of pictures that are known"


def _light(direction, exponent):
    """Radiance that grows upwards, less so under wide lobes."""
    return (1 + direction[1]) * np.array([1.0, 0.5, 0.2]).astype(direction.dtype) * (1 - 1 / (exponent + 2))


ENTRIES: Entries = (
    Entry(
        named("jaxrelight.lighting.filtered_lobes", "lobe_radiance reflected_lobes"),
        differentiable_in="lobes, omega_o, frame, and what light and visibility are differentiable in",
        example=lambda: Example(
            lambda lobes, o, normal: lobe_radiance(lobes, o, tangent_frame(normal), _light),
            (two_lobes(), OMEGA_O, OMEGA_I),
        ),
        kinks="as of `clip_lobe` and `sub_lobes`",
    ),
    Entry(
        named("jaxrelight.lighting.antialiasing", "averaged joined"),
        differentiable_in="samples; linear",
        example=lambda: Example(
            lambda direct, indirect: (
                antialiasing.averaged(direct, 2),
                antialiasing.joined(direct, indirect, np.array([[0, 0, 1, 1], [0, 1, 1, 1]])),
            ),
            (numbers(2, 4, 3), numbers(1, 2, 3)),
        ),
        orders=2,
        fixed="which pixel each sample is most like",
    ),
    Entry(
        named("jaxrelight.lighting.contract", "behind"),
        differentiable_in="background; linear",
        example=lambda: Example(lambda picture: contract.behind(picture, _COVERED), (numbers(2, 4, 3),)),
        orders=2,
        fixed="which pixels show a surface",
    ),
    Entry(
        (
            *named("jaxrelight.lighting.pixels", "assembled"),
            *named("jaxrelight.lighting.adaptive.view", "scattered taken_from AdaptiveView.image"),
        ),
        differentiable_in="rows, image; linear",
        example=lambda: Example(
            lambda rows, image: (
                assembled([rows], np.array([0, 2, 3, 1]), (2, 2)),
                adaptive_view.scattered([(np.array([0, 3, 2]), rows)], (2, 2)),
                adaptive_view.taken_from(image, np.array([2, 0])),
            ),
            (numbers(3, 3), numbers(2, 2, 3)),
        ),
        orders=2,
        fixed="places of pixels",
    ),
    Entry(
        named(
            "jaxrelight.lighting.measurement",
            "irradiance_of illuminance_of Measurement.illuminance Measurement.of measure",
        ),
        differentiable_in="radiance, irradiance; lights, as the pictures of the method are",
        example=lambda: Example(
            lambda radiance: measurement.illuminance_of(measurement.irradiance_of(radiance)), (numbers(1, 4, 3),)
        ),
        orders=2,
    ),
    Exempt(
        (
            *named("jaxrelight.lighting.contract", "Relighter.light Relighter.shade Relighter.with_materials"),
            *named("jaxrelight.lighting.contract", "Relighter.relit Relighter.background Relighter.view"),
            *named("jaxrelight.lighting.contract", "Relighter.trace Relighter.reference Relighter.pictured"),
            *named("jaxrelight.lighting.contract", "Relighter.scene_lights Relighter.samples_of"),
            *named("jaxrelight.lighting.contract", "Relighter.not_measured Relighter.sampled"),
        ),
        CONTRACT,
    ),
    Exempt(
        (
            *named("jaxrelight.lighting.contract", "Image.error Image.measure Image.measured_by Image.rgba"),
            *named("jaxrelight.lighting.contract", "Relighter.error Relighter.expected_error Relighter.picture"),
            *named("jaxrelight.lighting.measurement", "Measurement.summaries sensors_of_relighter"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.displayed_exposure"),
        ),
        "of pictures and measurements that are known, on the host; `Image.radiance` is differentiable",
    ),
    Exempt(
        (
            *named("jaxrelight.lighting.transport", "TransportRelighter.reference TransportRelighter.pictured"),
            *named("jaxrelight.lighting.transport", "TransportRelighter.not_measured TransportRelighter.error_bound"),
            *named("jaxrelight.lighting.transport", "TransportRelighter.notes_on TransportRelighter.resolution_errors"),
            *named("jaxrelight.lighting.resolution_check", "resolution_errors resolution_notes"),
            *named("jaxrelight.lighting.contract", "Relighter.notes_on"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.reference IndirectRelighter.pictured"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.sampled IndirectRelighter.not_measured"),
            *named("jaxrelight.lighting.prefiltered", "PrefilteredRelighter.reference PrefilteredRelighter.pictured"),
            *named("jaxrelight.lighting.prefiltered", "PrefilteredRelighter.not_measured"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.reference AdaptiveRelighter.pictured"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.expected_error"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.not_measured"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.exact_radiance"),
            *named("jaxrelight.lighting.adaptive.many_samples", "TakenPixels.in_picture ManySamples.of"),
            *named("jaxrelight.lighting.every_link", "EveryLink.of encoded"),
            *named("jaxrelight.lighting.exact_pixels", "SharpLobes.radiance ExactPixels.radiance"),
            *named("jaxrelight.lighting.exact_pixels", "PixelVisibility.of exact_pixels"),
            *named("jaxrelight.lighting.exact_receivers", "ExactReceivers.terms ExactAtVertices.divided"),
            *named("jaxrelight.lighting.light_terms", "largest_errors"),
            *named("jaxrelight.lighting.picture_error", "drawn_pixels bright_pixels joined shared_error"),
            *named("jaxrelight.lighting.picture_error", "measured_error"),
            *named("jaxrelight.lighting.reference", "Reference.of Reference.samples Reference.further"),
            *named("jaxrelight.lighting.reference", "Reference.divided ExactTransport.of ExactTransport.further"),
        ),
        _ERRORS,
    ),
    Exempt(
        (
            *named("jaxrelight.lighting.adaptive.estimate", "list_work"),
            *named("jaxrelight.lighting.adaptive.even_shading", "even_layers even_samples planning_pays"),
            *named("jaxrelight.lighting.adaptive.hierarchy", "Hierarchy.within Hierarchy.propagate_variance"),
            *named("jaxrelight.lighting.adaptive.hierarchy", "Hierarchy.influence Hierarchy.sources"),
            *named("jaxrelight.lighting.adaptive.hierarchy", "Hierarchy.levels hierarchy shade_all"),
            *named("jaxrelight.lighting.adaptive.layer_estimates", "estimate_layer display_slope largest_around"),
            *named("jaxrelight.lighting.adaptive.layer_estimates", "looked_up"),
            *named("jaxrelight.lighting.adaptive.local_bandwidth", "travelled onto_surface off_surface curved"),
            *named("jaxrelight.lighting.adaptive.local_bandwidth", "filtered reflected"),
            *named("jaxrelight.lighting.adaptive.pilot", "measure_plan"),
            *named("jaxrelight.lighting.adaptive.planning", "LayerPlan.error LayerPlan.noise Plan.maps make_plan"),
            *named("jaxrelight.lighting.adaptive.prediction", "draw directions predict"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.predicted AdaptiveRelighter.plan"),
            *named("jaxrelight.lighting.adaptive.sampled_brdf", "SampledBrdf.texture_bandwidth BrdfSampler.bandwidth"),
            *named("jaxrelight.lighting.adaptive.trials", "Trials.radiance Trials.weight Trials.seen"),
            *named("jaxrelight.lighting.adaptive.trials", "NoiseTrial.square try_noise calibrate"),
        ),
        _SAMPLES,
    ),
    Exempt(
        (
            *named("jaxrelight.lighting.transport", "TransportRelighter.view TransportRelighter.trace"),
            *named("jaxrelight.lighting.transport", "TransportRelighter.samples_of"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.view IndirectRelighter.trace"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.alpha"),
            *named("jaxrelight.lighting.prefiltered", "PrefilteredRelighter.view PrefilteredRelighter.trace"),
            *named("jaxrelight.lighting.prefiltered", "PrefilteredRelighter.samples_of"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.view AdaptiveRelighter.trace"),
            *named("jaxrelight.lighting.adaptive.view", "make_view"),
            *named("jaxrelight.lighting.lobe_rays", "traced_shares"),
            *named("jaxrelight.lighting.shadows", "SurfacePoints.is_occluded SurfacePoints.distances surface_points"),
            *named("jaxrelight.lighting.shadows", "all_visible trace_visibility unpacked"),
            *named("jaxrelight.lighting.transport_view", "trace_receivers samples_of_pixels"),
            *named("jaxrelight.lighting.visible_surfaces", "trace_view corners_of with_samples"),
        ),
        RAYS,
    ),
    Exempt(
        (
            *named("jaxrelight.lighting.prepare", "prepare prepare_with_build open_store default_method"),
            *named("jaxrelight.lighting.transport", "TransportRelighter.method TransportRelighter.camera"),
            *named("jaxrelight.lighting.transport", "TransportRelighter.sensors TransportRelighter.scene_lights"),
            *named("jaxrelight.lighting.transport", "TransportRelighter.exact TransportRelighter.sharded"),
            *named("jaxrelight.lighting.indirect", "IndirectView.surfaces IndirectRelighter.method"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.camera IndirectRelighter.sensors"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.transport IndirectRelighter.materials"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.scene_lights IndirectRelighter.sharded"),
            *named("jaxrelight.lighting.prefiltered", "PrefilteredRelighter.scene_lights"),
            *named("jaxrelight.lighting.adaptive.relighter", "SampledMaterial.unsampled sampled_materials"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.materials"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.scene_lights"),
            *named("jaxrelight.lighting.adaptive.sampled_brdf", "sampled"),
            *named("jaxrelight.lighting.transport_means", "direct_parts named_components blocks_by_means"),
            *named("jaxrelight.lighting.transport_means", "without_bounces terms_alone"),
            *named("jaxrelight.lighting.visible_surfaces", "surface_material surface_component"),
        ),
        "prepared scenes and their parts, as they are",
    ),
    Exempt(
        (
            *named("jaxrelight.lighting.antialiasing", "pixel_angle nearest_pixels"),
            *named("jaxrelight.lighting.pixels", "places padded"),
            *named("jaxrelight.lighting.shadows", "SurfacePoints.taken group_lights Remembered.get Remembered.put"),
            *named("jaxrelight.lighting.adaptive.view", "Probe.known_points AdaptiveView.part_image"),
            *named("jaxrelight.lighting.adaptive.view", "AdaptiveView.of_part"),
            *named("jaxrelight.lighting.transport_view", "TransportView.shown TransportView.taken"),
            *named("jaxrelight.lighting.visible_surfaces", "SurfacePart.positions VisibleSurfaces.pixels"),
            *named("jaxrelight.lighting.visible_surfaces", "VisibleSurfaces.taken"),
        ),
        HOST,
    ),
    Exempt(named("jaxrelight.lighting.filtered_reflection", "exponents_of"), CHOICE),
)
