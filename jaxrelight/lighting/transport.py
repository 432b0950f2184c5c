"""Lighting by precomputed transport (Wang 2006 §4.3): light → light terms, and light terms → image."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int

from jaxrelight.basis import latlong
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Material
from jaxrelight.brdf.outgoing import outgoing
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import PixelWeight
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.lighting.antialiasing import samples_along
from jaxrelight.lighting.contract import VISIBILITY, Image, Relighter, Report, behind, image_of, kept_beside
from jaxrelight.lighting.direct_light import shade_lights
from jaxrelight.lighting.exact_pixels import NamedComponent
from jaxrelight.lighting.exact_receivers import ExactAtVertices
from jaxrelight.lighting.filtered_reflection import exponents_of, filtered_radiance
from jaxrelight.lighting.light_terms import LightTerms, largest_errors, light_terms, with_emitted
from jaxrelight.lighting.lobe_rays import traced_shares
from jaxrelight.lighting.picture_error import Pictured
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lighting.reference import ExactTransport, Reference, Sample
from jaxrelight.lighting.resolution_check import resolution_errors, resolution_notes
from jaxrelight.lighting.shadows import LightGroup, Visibility, group_lights, trace_visibility
from jaxrelight.lighting.sun import sun_terms
from jaxrelight.lighting.transport_means import (
    LOBES,
    blocks_by_means,
    direct_parts,
    named_components,
    terms_alone,
    without_bounces,
)
from jaxrelight.lighting.transport_view import (
    TransportView,
    image_of_samples,
    in_picture,
    samples_of_pixels,
    trace_receivers,
)
from jaxrelight.lighting.visible_surfaces import (
    Corners,
    SurfaceMaterial,
    SurfacePart,
    VisibleSurfaces,
    emitted,
    surface_component,
)
from jaxrelight.lights.environment import Environment, check_pixels, coarsened, encode, texels_of, with_coarse_pixels
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.lights.prefiltered import COARSE_RESOLUTION, PrefilteredMaps, maps_of
from jaxrelight.lights.sun import split_sun
from jaxrelight.methods import Transport
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.transport import rebake as baking
from jaxrelight.transport.changed_materials import with_materials
from jaxrelight.transport.model import Block, PrecomputedTransport


class TransportLight(NamedTuple):
    """Light as `TransportRelighter` takes it.

    Attributes:
        environment: None for none.
        terms: light terms of every block, under the environment and what surfaces emit.
        groups: the local lights.
        maps: of the environment, for filtered lobes; None without either.
        arriving: what the terms are made of, for other materials.
    """

    environment: Environment | None
    terms: LightTerms
    groups: tuple[LightGroup, ...]
    maps: PrefilteredMaps | None = None
    arriving: "ArrivingLight | None" = None


class ArrivingLight(NamedTuple):
    """What light terms are made of.

    Attributes:
        light: the operators' input, without a sun that is split off.
        sun: that sun, as the operators' input; None for none.
        texels: numbers of its texels.
        radiance: theirs.
    """

    light: Float[Array, "*n d c"]
    sun: Float[Array, "d c"] | None = None
    texels: Int[Array, " t"] | None = None
    radiance: Float[Array, "t c"] | None = None


class TransportRelighter(Relighter[TransportView, TransportLight, Visibility]):
    """Lights a precomputed scene from an environment with shadows and bounces; see `Transport` for the dials.

    Local lights are direct light with shadow rays.
    """

    transport: PrecomputedTransport
    materials: tuple[SurfaceMaterial, ...]
    # Exponents of the maps that filtered lobes read; None for maps of all.
    exponents: tuple[float, float] | None = eqx.field(static=True)

    def __init__(self, transport: PrecomputedTransport, every_exponent: bool = False):
        self.transport = transport
        self.exponents = None if every_exponent else exponents_of(transport.lobes)
        parts = (*transport.blocks, *transport.lobes)
        names = list(dict.fromkeys(part.material for part in parts))
        self.materials = tuple(_material(name, transport) for name in names)

    @property
    def method(self) -> Transport:
        """The dials of the store."""
        assert isinstance(self.transport.method, Transport)
        return self.transport.method

    @property
    def camera(self) -> Camera:
        """The scene's."""
        return self.transport.stored.camera

    @property
    def sensors(self) -> Sensors | None:
        """The scene's, where it was prepared at them."""
        return self.transport.stored.sensors

    def scene_lights(self) -> Lights:
        """The scene's own lights, read from the store."""
        return self.transport.stored.lights()

    def exact(self) -> "TransportRelighter":
        """The same with nothing of direct light left out: rows are baked from visibility at every use.

        The reference for what compression leaves out; see `transport.rebake.exact`.
        """
        return TransportRelighter(baking.exact(self.transport))

    def sharded(self, mesh: Mesh) -> "TransportRelighter":
        """The same with its rows spread over the devices of a mesh of one axis, of one process or of many.

        Raises:
            InputError: for another mesh, or where all coefficients are kept, whose rows are in no operator.
        """
        return TransportRelighter(self.transport.sharded(mesh))

    def rebake(self, reflections: Sequence[Reflection]) -> "TransportRelighter":
        """The same with another reflection for each block, without a new ray; differentiable in the reflections.

        See `transport.rebake.rebake`.

        Raises:
            InputError: where light bounces.
        """
        return TransportRelighter(baking.rebake(self.transport, list(reflections)))

    def replace_lobes(self, lobes: Sequence[LobeSum | SpatialLobes]) -> "TransportRelighter":
        """The same with other lobes in place of each of the transport's filtered ones; differentiable in them.

        Nothing is baked or traced: filtered visibility is of geometry alone. What such lobes bounce stays what it was.

        Raises:
            InputError: for another number of them.
        """
        old = self.transport.lobes
        if len(lobes) != len(old):
            raise InputError(f"{len(lobes)} BRDFs of lobes were given, but {len(old)} are filtered; give one for each")
        replaced = tuple(
            dataclasses.replace(part, brdf=brdf.packed() if isinstance(brdf, SpatialLobes) else brdf)
            for part, brdf in zip(old, lobes, strict=True)
        )
        return TransportRelighter(dataclasses.replace(self.transport, lobes=replaced))

    def with_materials(
        self, materials: Mapping[str, Brdf | Material], *, bounces: Literal["held", "followed"] | None = None
    ) -> "TransportRelighter":
        """The same scene with other materials, see `Relighter.with_materials`.

        A diffuse albedo or texture is a factor on light terms, which stay what they are. Filtered lobes are exchanged.
        Rows of other BRDFs are baked from stored visibility whenever light terms are made, at vertices by the factors
        that are best for the view maps before. Bounced light that arrives stays what it was: diffuse surfaces reflect
        it by their own albedo, others by the shape of the lobes before, and as much as the new ones.

        Raises:
            InputError: as every relighter; with bounces, for bounces that are to be followed, and for lobes whose
                direct light is of factors.
        """
        if bounces == "followed" and self.method.bounces:
            raise InputError("bounced light of precomputed transport cannot follow materials; prepare the scene anew")
        given = self._materials_of(materials, [one.name for one in self.materials])
        return TransportRelighter(with_materials(self.transport, given), every_exponent=True)

    @property
    def held(self) -> tuple[str, ...]:
        """Visibility, kept coefficients, and what arrives by bounces."""
        method, lobes = self.method, bool(self.transport.lobes)
        return (
            VISIBILITY,
            *(["which coefficients are kept"] if method.coefficients != "all" else []),
            *(["the narrower lobes that filtered ones are divided into"] if lobes else []),
            *(["bounced light that arrives at surfaces"] if method.bounces else []),
        )

    def relit(self, lit: TransportLight) -> TransportLight:
        """The light with light terms of the blocks that other materials changed; see `Relighter.relit`."""
        blocks, arriving = self.transport.blocks, lit.arriving
        changed = [number for number, block in enumerate(blocks) if block.remade]
        if not changed or arriving is None:
            return lit
        terms = list(lit.terms)
        for number, own in zip(changed, self._terms_of(arriving, [blocks[number] for number in changed]), strict=True):
            terms[number] = own
        return lit._replace(terms=tuple(terms))

    def view(self, camera: Camera | None = None, antialiasing: int = 1) -> TransportView:
        """What a camera sees; by default the scene's.

        Args:
            camera: any; by default the scene's.
            antialiasing: samples of surfaces in a pixel: 1, 4 or 16. Between vertices, all light is that of samples.
                Where receivers are pixels, samples have coverage and local lights of their own, and take the radiance
                of the pixel that they are most like; those that are like none do not count.

        Raises:
            InputError: for another camera than the scene's where receivers are pixels, or another number of samples.
        """
        own, factor = self.camera, samples_along(antialiasing)
        camera = camera or own
        if self.transport.method.receivers == "pixels" and camera != own:
            raise InputError(
                "this scene was precomputed for the pixels of one camera; for other views precompute with receivers "
                "'vertices' (--receivers vertices), which any camera sees at no cost"
            )
        eye, of_pixels = self.sensors or camera, self.transport.method.receivers == "pixels"
        surfaces, corners = trace_receivers(self.transport, self.materials, eye, 1 if of_pixels else factor)
        shares = tuple(self._traced_shares(part, surfaces) for part in surfaces.parts)
        view = TransportView(surfaces, corners, shares)
        if not of_pixels or factor == 1:
            return view
        samples, nearest = samples_of_pixels(self.transport.geometry, eye, self.materials, factor)
        samples = dataclasses.replace(samples, covered=nearest >= 0)
        return dataclasses.replace(view, samples=samples, nearest=nearest)

    def samples_of(self, view: TransportView) -> TransportView:
        """The view whose pixels are those that are shaded: samples between vertices, or receivers."""
        if view.nearest is None and view.surfaces.factor == 1:
            return view

        def shaded() -> TransportView:
            return TransportView(dataclasses.replace(view.surfaces, factor=1), view.corners, view.shares)

        return kept_beside(view, "_samples", shaded)

    def _traced_shares(self, part: SurfacePart, surfaces: VisibleSurfaces) -> tuple[Array | None, ...]:
        """What is visible of the lobes of one part's pixels, of those that views trace."""
        name = self.materials[part.material].name
        return tuple(
            traced_shares(
                lobes.brdf,
                part.pixels,
                surfaces.points,
                int(part.start),
                self.method.reflection_rays,
                lobes.narrower,
            )
            if lobes.material == name and lobes.visibility is None
            else None
            for lobes in self.transport.lobes
        )

    def light_vector(
        self,
        pixels: Float[Array | np.ndarray, "h w 3"],
        rotate_y: float | Float[Array, ""] = 0.0,
        scale: float | Float[Array, ""] = 1.0,
    ) -> Float[Array, "d c"]:
        """The operator's input for a lat-long map. Pure and differentiable in all three.

        Raises:
            InputError: for known pixels that are not finite.
        """
        check_pixels(pixels, "the environment")
        return self._light_vector(pixels, rotate_y, scale)

    def _light_vector(self, pixels, rotate_y, scale) -> Float[Array, "d c"]:
        pixels = coarsened(pixels, self.method.resolution)
        resampling = latlong.area_resampling(*pixels.shape[:2], self.method.resolution, pixels.dtype)
        return encode(pixels, rotate_y, scale, resampling, self.transport.basis)

    def terms(self, light: Float[Array | np.ndarray, "*n d c"]) -> LightTerms:
        """Light terms of a light vector: one application of the operator.

        Those of a block are followed by zeros, which nobody reads, up to one of few lengths, so that another scene of
        about the same size compiles nothing new. Of n light vectors, terms are [n, v, k, c], by one product for all,
        which is compiled anew for every n: with clusters, it costs less than one after the other.

        Raises:
            InputError: for a light of another number of coefficients.
        """
        return self._products(light, self.transport.blocks)

    def _products(self, light: Float[Array | np.ndarray, "*n d c"], blocks: Sequence[Block]) -> LightTerms:
        d = self.transport.basis.size
        if light.ndim not in (2, 3) or light.shape[-2] != d:
            raise InputError(f"light has shape {tuple(light.shape)}; it must be [{d:,}, c], or [n, {d:,}, c]")
        light = as_array(light)
        return tuple(with_emitted(light_terms(block.operator, light, block), block) for block in blocks)

    def light(self, lights: LightsLike) -> TransportLight:
        """Light terms under an environment, and the local lights: what a change of light costs.

        Where rows are compressed, the few texels of a sun are integrated by themselves, with a shadow ray from every
        receiver to each; what they bounce comes from the operator like all else. As a sun is found by how much it
        outshines the rest, terms are linear in the light only to within what compression leaves out; with
        `split_sun=False` among the dials they are linear.
        """
        lights = as_lights(lights)
        environment = lights.environment
        used = environment
        if environment is not None and is_traced(environment.pixels):
            # Terms and maps share the slopes in all pixels of a large map, which would be as large for each of them.
            used = with_coarse_pixels(environment, max(self.method.resolution, COARSE_RESOLUTION))
        if used is None:
            pixels = np.zeros((2, 4, 3), np.float32)
            arriving = ArrivingLight(self.light_vector(pixels))
        elif self.method.coefficients == "all" or not self.method.split_sun:
            arriving = ArrivingLight(self._light_vector_of(used))
        else:
            arriving = self._without_sun(used)
        terms = self._terms_of(arriving, self.transport.blocks)
        groups = group_lights(lights.local, self.transport.surfaces.centre)
        return TransportLight(environment, terms, groups, self._maps(used), arriving)

    def _without_sun(self, environment: Environment) -> ArrivingLight:
        """An environment with its sun split off, where it has one."""
        whole = texels_of(environment, self.method.resolution)
        rest, sun, texels, radiance = _split(whole, self.transport.basis)
        known = jax.lax.stop_gradient(radiance)
        if not is_traced(known) and not np.asarray(known).any():
            return ArrivingLight(rest)
        return ArrivingLight(rest, sun, texels, radiance)

    def _terms_of(self, arriving: ArrivingLight, blocks: Sequence[Block]) -> LightTerms:
        """Light terms of some blocks."""
        terms = self._products(arriving.light, blocks)
        if arriving.sun is None:
            return terms
        assert arriving.texels is not None
        assert arriving.radiance is not None
        with_sun = list(sun_terms(self.transport, arriving.texels, arriving.radiance, blocks))
        for number, block in enumerate(blocks):
            for bounced in block.bounced:
                with_sun[number] += light_terms(bounced, arriving.sun, block)
        return tuple(part + more for part, more in zip(terms, with_sun, strict=True))

    def light_many(self, environments: Sequence[Environment]) -> tuple[TransportLight, ...]:
        """What `light` gives for each of several environments: by one product for all; no sun is split off."""
        vectors = [self._light_vector_of(one) for one in environments]
        terms = self.terms(jnp.stack(vectors))
        return tuple(
            TransportLight(one, tuple(part[number] for part in terms), (), self._maps(one), ArrivingLight(vector))
            for number, (one, vector) in enumerate(zip(environments, vectors, strict=True))
        )

    def _maps(self, environment: Environment | None) -> PrefilteredMaps | None:
        """What filtered lobes read of an environment; None where there are none."""
        if environment is None or not self.transport.lobes:
            return None
        return maps_of(environment, between=self.exponents)

    def _light_vector_of(self, environment: Environment) -> Float[Array, "d c"]:
        # An environment's pixels are checked when it is made.
        return self._light_vector(environment.pixels, environment.rotate_y, environment.scale)

    def trace(self, lit: TransportLight, view: TransportView, *, report: Report | None = None) -> Visibility:
        """Shadow rays from pixels towards local lights."""
        return trace_visibility(view.shown.points, lit.groups)

    def shade(
        self,
        lit: TransportLight,
        view: TransportView,
        traced: Visibility | None = None,
        *,
        report: Report | None = None,
    ) -> Image:
        """Radiance of every pixel: light terms closed by the view, filtered lobes, local lights, and emission."""
        traced = self.trace(lit, view) if traced is None else traced
        shown = view.shown
        direct = shade_lights(self.materials, shown, lit.groups, traced)
        own = self._shaded_terms(lit.terms, view, self._weights), self._shaded_lobes(lit, view)
        if view.nearest is None:
            image = image_of((*own, direct), shown.covered, shown.factor)
        else:
            image = image_of_samples(own, direct, shown.covered, view.nearest)
        return self._measuring(image, lit, view)

    def reference(self, view: TransportView, samples: int, seed: int) -> Reference:
        """Exact transport of the view's pixels, without bounces."""

        def taken(chosen: Int[np.ndarray, " s"]) -> tuple[TransportView, VisibleSurfaces]:
            some = view.taken(chosen)
            return some, some.surfaces

        def named(number: int) -> list[NamedComponent]:
            return named_components(self.transport, self.materials[number])

        exact = view.surfaces, taken, named, self.method.resolution, samples, seed
        return ExactAtVertices(self, *exact) if self.method.receivers == "vertices" else ExactTransport(*exact)

    def pictured(self, radiance: Float[np.ndarray, "s 3"], lit: TransportLight, sample: Sample) -> Pictured:
        """Direct light of the environment by filtered lobes, and by the rows of each kind of reflection."""
        view = sample.view
        whole = np.asarray(self.shade(lit, view).radiance)[0]
        if lit.environment is None:
            return Pictured({}, whole)
        terms = self.direct_terms(lit)
        by_means, emission = {}, np.asarray(self.shade_terms(terms_alone(terms, ()), view))[0]
        for name, numbers in blocks_by_means(self.transport).items():
            by_means[name] = np.asarray(self.shade_terms(terms_alone(terms, numbers), view))[0] - emission
        lobes = self.shade_lobes(lit, view)
        if lobes is not None:
            by_means[LOBES] = np.asarray(lobes)[0]
        return Pictured(by_means, whole - sum(by_means.values(), np.zeros_like(whole)))

    def direct_terms(self, lit: TransportLight) -> LightTerms:
        """Light terms without what bounces bring."""
        if not self.method.bounces or lit.environment is None:
            return lit.terms
        return TransportRelighter(without_bounces(self.transport)).light(lit.environment).terms

    def not_measured(self, lit: TransportLight) -> tuple[str, ...]:
        """What bounces bring."""
        return ("what bounces bring",) if self.method.bounces else ()

    def notes_on(self, lights: LightsLike) -> tuple[str, ...]:
        """A line where the resolution was chosen for an environment that is not as sharp as this one."""
        return resolution_notes(self.transport, as_lights(lights).environment)

    def resolution_errors(self, environment: Environment) -> dict[int, float]:
        """The error of a resolution that was chosen by need under an environment, and of finer ones.

        See `lighting.resolution_check.resolution_errors`.

        Raises:
            InputError: if a layer of the store is damaged.
        """
        return resolution_errors(self.transport, environment)

    def shade_lobes(self, lit: TransportLight, view: TransportView) -> Float[Array, "h w 3"] | None:
        """Direct light of an environment that filtered lobes reflect: filtered light times filtered visibility.

        Differentiable in the environment's maps, turn and scale, and in the lobes; None where there are none.
        """
        radiance = self._shaded_lobes(lit, view)
        return None if radiance is None else in_picture(radiance, view)

    def _shaded_lobes(self, lit: TransportLight, view: TransportView) -> Float[Array, "h w 3"] | None:
        environment, maps = lit.environment, lit.maps
        if maps is None or environment is None:
            return None
        rows = []
        turn, scale = environment.rotate_y, environment.scale
        for part, corners, of_part in zip(view.surfaces.parts, view.corners, view.shares, strict=True):
            radiance = jnp.zeros((len(part.pixels.pixel), 3), part.pixels.omega_o.dtype)
            for lobes, shares in zip(self.transport.lobes, of_part, strict=True):
                if lobes.material == self.materials[part.material].name:
                    radiance = filtered_radiance(
                        lobes, part.pixels, corners.receivers, corners.weights, shares, maps, turn, scale, radiance
                    )
            rows.append(radiance)
        return view.surfaces.image(rows)

    def error_bound(self, environment: Environment, view: TransportView) -> Float[Array, "h w c"]:
        """How far off each pixel's radiance is at most for the coefficients that rows leave out, and their codes.

        By Cauchy and Schwarz, a row's error is no more than the length of what it leaves out times that of the light:
        known before a light is applied, and reached by the worst one. Factors, lobes, interpolation and rays are not
        counted; see `error` for all of it.

        Args:
            environment: any; a sun that is split off is left out of no row, unless it bounces.
            view: from `view`.
        """
        light = self._light_vector_of(environment)
        if self.method.split_sun and self.method.coefficients != "all" and not self.method.bounces:
            light = _split(texels_of(environment, self.method.resolution), self.transport.basis)[0]
        bounds = tuple(largest_errors(block.dropped, light, block) for block in self.transport.blocks)
        return in_picture(self._shaded_terms(bounds, view, self._weights, bound=True), view)

    def shade_terms(
        self, terms: LightTerms, view: TransportView, weights: tuple[PixelWeight, ...] | None = None
    ) -> Float[Array, "h w c"]:
        """Radiance of every pixel by light terms, 0 where no surface is seen, without filtered lobes.

        Terms are interpolated to the pixel, then closed by the view side of its own direction to the eye and by the
        weights at its texture coordinates: Σ_b w_b Σ_k view_side_bk · (T_b x)_k. Emission is added. Differentiable in
        terms and weights.

        Args:
            terms: of every block.
            view: from `view`.
            weights: of the blocks; by default those that they have.
        """
        return in_picture(self._shaded_terms(terms, view, self._weights if weights is None else weights), view)

    @property
    def _weights(self) -> tuple[PixelWeight, ...]:
        """Of the blocks."""
        return tuple(block.weight for block in self.transport.blocks)

    def _shaded_terms(
        self, terms: LightTerms, view: TransportView, weights: tuple[PixelWeight, ...], *, bound: bool = False
    ) -> Float[Array, "h w c"]:
        """`shade_terms`; or of bounds of terms those of radiance, without emission."""
        blocks = self.transport.blocks
        names = [material.name for material in self.materials]
        of_material: dict[int, list[int]] = {number: [] for number in range(len(names))}
        for number, block in enumerate(blocks):
            of_material[names.index(block.material)].append(number)
        rows = []
        for part, corners in zip(view.surfaces.parts, view.corners, strict=True):
            emission = None if bound else self.materials[part.material].emission
            radiance = emitted(emission, part.pixels)
            for number in of_material[part.material]:
                reflection = _view_sides(blocks[number].reflection)
                given = reflection, weights[number], terms[number], part.pixels, corners, radiance
                radiance = _radiance(*given, bound=bound)
            rows.append(radiance)
        return view.surfaces.image(rows)

    def background(self, lit: TransportLight, view: TransportView) -> Float[Array, "h w 3"]:
        """The environment where no surface is seen."""
        surfaces = view.shown
        if lit.environment is None:
            return jnp.zeros((*view.shape, 3), surfaces.u.dtype)
        return behind(surfaces.background(lit.environment), surfaces.covered, surfaces.factor)


def _material(name: str, transport: PrecomputedTransport) -> SurfaceMaterial:
    """Puts a material together from its blocks and lobes."""
    parts = [part for part in (*transport.blocks, *transport.lobes) if part.material == name]
    emission = next((part.emission for part in parts if part.emission is not None), None)
    components = tuple(surface_component(part.brdf, part.weight) for part in direct_parts(transport, name))
    return SurfaceMaterial(name, components, emission)


@jax.jit
def _split(texels, basis):
    """Light vectors of an environment without its sun, and of the sun; its texels and their radiance."""
    split = split_sun(texels)
    rest, sun = basis.encode(jnp.stack([split.rest.T, split.sun.T]))
    return rest.T, sun.T, split.texels, split.radiance


def _view_sides(reflection: Reflection) -> Reflection:
    """What the view needs of a reflection: of a fixed view only that there is one."""
    if not isinstance(reflection, FixedView):
        return reflection
    return FixedView(reflection.brdf, jnp.zeros(3, reflection.omega_o.dtype))


@functools.partial(jax.jit, static_argnames="bound")
def _radiance(
    reflection: Reflection,
    weight: PixelWeight,
    terms: Float[Array, "v k c"],
    pixels: SurfacePixels,
    corners: Corners,
    others: Float[Array, "p c"],
    bound: bool = False,
) -> Float[Array, "p c"]:
    at_corners = terms.at[corners.receivers].get(mode="promise_in_bounds")
    # pixels p, corners b, terms k, channels c
    light = jnp.einsum("pb,pbkc->pkc", corners.weights, at_corners, precision="highest")
    view = outgoing(reflection, weight, pixels.omega_o, pixels.uv, pixels.footprint)
    view = jnp.abs(view) if bound else view
    return others + jnp.sum(view * light, axis=1)
