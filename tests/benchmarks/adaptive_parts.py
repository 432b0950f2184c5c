"""What adaptive shading rests on: predictions against measurements, parts of its gain, antialiasing, extremes."""

import argparse
import dataclasses
import time

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage, stats

import jaxrelight as jr
from jaxrelight.basis import latlong
from jaxrelight.brdf.bandwidth import bandwidth_table, compressed
from jaxrelight.geometry.mesh import transformed
from jaxrelight.images import srgb_decode, srgb_encode
from jaxrelight.images.tone import to_unit
from jaxrelight.lighting.adaptive.relighter import AdaptiveLight, AdaptiveRelighter
from jaxrelight.lighting.adaptive.view import AdaptiveView
from jaxrelight.lighting.direct_light import shade_lights
from jaxrelight.lighting.shadows import group_lights, trace_visibility
from jaxrelight.lights.sky import Sky
from jaxrelight.numerics.random_numbers import vogel_points
from tests.benchmarks.adaptive import BASELINE, SEED, Case, as_good, brdf_of, first_good, prepared, scene_of, timed
from tests.benchmarks.measuring import RESULTS, Report, percent

# Pixels along a side of those in which frequencies are measured.
WINDOW = 32
# Of whole frames.
FRAME_TOLERANCE = 0.004


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.adaptive_parts", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small pictures; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    mesh, material = "spot" if quick else "bunny", "two lobes"
    size, samples = (128, 256) if quick else (512, BASELINE)
    parameters = f"{mesh}, {material}, {size}×{size}, Venice sunset, {samples} samples in every pixel of the baseline"
    with Report("adaptive_parts", "What shading where bandwidth asks rests on", parameters, write=not quick) as report:
        case = Case(mesh, material, size, samples, shadows=False)
        parts_of_it(report, case)
        probes(report, case)
        correlations(report, case)
        antialiasing(report, mesh, material, size)
        components(report, 64 if quick else 256)
        lambert_alone(report, mesh, size)
        extremes(report, 64 if quick else 256, write=not quick)


def parts_of_it(report: Report, case: Case):
    """What adaptive shading and filtered look-ups bring alone."""
    wanted, baseline = case.baseline()
    together = as_good(case, wanted, baseline)
    apart = as_good(case, wanted, baseline, filtered=False)

    def good(samples: float) -> bool:
        return case.psnr(case.uniform(16 * round(samples / 16), filtered=True)) >= wanted

    even = 16 * round(first_good(good, 2 * case.samples) / 16)
    seconds = timed(lambda: case.uniform(even, filtered=True))[1]
    rows = [
        ["adaptive", together[1], together[3]],
        ["adaptive, look-ups of single texels as the baseline's", apart[1], apart[3]],
        ["the same number in every pixel, filtered look-ups", str(even), f"{baseline / seconds:.1f}×"],
    ]
    report.text(f"{case.name}: what it takes to be as good as the baseline, part by part.")
    report.table(["", "samples", "faster"], rows)


def probes(report: Report, case: Case):
    """Samples that predict (figure 12)."""
    rows = []
    for count in (8, 16, 64, 256, 1024):
        jax.block_until_ready(case.predicted(samples=count))
        start = time.perf_counter()
        predicted = jax.block_until_ready(case.predicted(samples=count))
        seconds = time.perf_counter() - start
        plan = case.plan(64, predicted)
        quality = case.psnr(case.adaptive(plan))
        rows.append([str(count), f"{seconds:.2f} s", percent(plan.shaded / case.covered.sum()), f"{quality:.2f} dB"])
    report.text(
        f"{case.name}, 64 samples a pixel: by the number n_b of samples that predict, at a quarter of the pixels."
    )
    report.table(["n_b", "prediction", "shaded", "quality"], rows)


def correlations(report: Report, case: Case):
    """Prediction against measurement (figure 14)."""
    predicted = case.predicted()[0][0]
    pixel = np.asarray(case.view.probes[0].pixels.pixel)
    real = np.flatnonzero(pixel < case.covered.size)
    real = real[interior(case.covered).ravel()[pixel[real]]]
    ok, measured = windowed_frequencies(case.truth.mean(axis=2), case.covered, pixel[real])
    rows = []
    for name, heading in (("image", "average (eq. 4)"), ("largest", "maximum (figure 6)")):
        values = np.asarray(getattr(predicted, name))
        own = values[real], windowed(values, pixel, case.covered.shape)[pixel[real]]
        rho = [stats.spearmanr(of[ok], wanted[ok])[0] for wanted in measured for of in own]
        rows.append([heading, *(f"{of:.2f}" for of in rho)])
    report.text(
        f"{case.name}: rank correlation of the bandwidth that is predicted with that of windows of 32×32 pixels, in "
        "pixels off the silhouette. Of a window, the root mean square of its frequencies, its mean the one of "
        "frequency 0, as what is predicted is a root mean square; and the frequency below which 95 % of the energy of "
        "what is left without the mean lies, which says nothing of how much that is. Prediction of the pixel in the "
        "middle, and of all in the window (root mean square)."
    )
    report.table(["", *(f"{of}, {by}" for of in ("mean square", "95 %") for by in ("pixel", "window"))], rows)
    spread = measured_variance(case)[real]
    rho = [stats.spearmanr(np.asarray(of)[real], spread)[0] for of in
           (predicted.variance, predicted.variance_of_bandwidth)]  # fmt: skip
    report.text(
        f"Variance, against that of 1,024 samples of a texel each: rank correlation {rho[0]:.2f} by second moments, "
        f"{rho[1]:.2f} by eq. 8."
    )


def antialiasing(report: Report, mesh: str, material: str, size: int):
    """Whole frames with one, four and sixteen samples of surfaces in a pixel (figure 15)."""
    scene, rows = scene_of(mesh, brdf_of(material), size), []
    lit = prepared(scene).light(scene.lights)
    for factor in (1, 2, 4):
        _frame(scene, lit, factor)
        start = time.perf_counter()
        image, covered = jax.block_until_ready(_frame(scene, lit, factor))
        seconds = time.perf_counter() - start
        plan = image.measured["plan"]
        figures = f"{plan.samples / (covered / factor**2):.0f}", percent(plan.shaded / covered)
        rows.append([str(factor**2), f"{seconds:.2f} s", *figures, seconds])
    report.text(
        f"{mesh}, {material}, tolerance {FRAME_TOLERANCE}: whole frames, with tracing, by samples of surfaces in a "
        "pixel."
    )
    table = [[*row[:-1], f"{row[-1] / rows[0][-1]:.2f}×"] for row in rows]
    report.table(["samples of surfaces", "frame", "samples of light", "shaded", "of one"], table)


def _frame(scene: jr.Scene, lit: AdaptiveLight, factor: int) -> tuple[jr.Image, int]:
    """A picture, and how many samples show a surface."""
    relighter = prepared(scene, tolerance=FRAME_TOLERANCE, shadows=False)
    view = relighter.view(antialiasing=factor**2)
    return relighter.shade(lit, view), view.covered_count()


def components(report: Report, resolution: int):
    """What principal components leave out of the tables of bandwidth (figure 8)."""
    brdf = brdf_of("RGL paint")
    seconds = time.perf_counter()
    table = bandwidth_table(brdf, resolution)
    seconds = time.perf_counter() - seconds
    counts = [k for k in (1, 2, 4, 8, 12) if k < len(table.values)]
    report.text(
        f"Bandwidth of the RGL paint, {' × '.join(map(str, table.values.shape))} from slices of {resolution}², made in "
        f"{seconds:.1f} s: error of what so many principal components leave, root mean square relative to the table."
    )
    report.table(["components", *map(str, counts)], [["error", *(percent(compressed(table, k)[1]) for k in counts)]])


def lambert_alone(report: Report, mesh: str, size: int):
    """Nothing varies: hardly a pixel is shaded."""
    scene = scene_of(mesh, jr.lambert(0.6), size)
    relighter = prepared(scene, tolerance=0.01, shadows=False)
    view = relighter.view()
    image = relighter.shade(relighter.light(jr.environment(np.ones((16, 32, 3), np.float32))), view)
    facing = view.part_image()[:size, :size] >= 0
    worst = float(np.abs(np.asarray(image.radiance)[facing] / 0.6 - 1).max())
    shaded = percent(image.measured["plan"].shaded / view.covered_count())
    report.text(
        f"{mesh}, Lambert under a constant sky: largest relative error {worst:.1e}, {shaded} of the pixels shaded."
    )


def extremes(report: Report, size: int, *, write: bool):
    """Where predictions could fail, against many samples everywhere."""
    step = np.where(np.arange(512) < 256, 0.02, 1.0)[None, :, None] * np.ones((256, 1, 3))
    sun = np.full((256, 512, 3), 0.1)
    sun[60, 100] = 1e5
    ball, wires = jr.sphere(0.5, 64), [transformed(jr.plane([0.004, 2]), turned(x)) for x in np.linspace(-0.6, 0.6, 9)]
    floor = jr.Part(jr.plane([40, 40]), "skin")
    mirror, soft = jr.phong(0.05, 0.6, 1e4), jr.phong(0.3, 0.3, 40)
    cases = {
        "a sky of two halves, exponent 1e4": (step, mirror, [jr.Part(ball, "skin")]),
        "a sun of 1e5, exponent 40": (sun, soft, [jr.Part(ball, "skin"), jr.Part(jr.plane([4, 4]), "skin")]),
        "wires, thinner than a pixel": (step, soft, [jr.Part(one, "skin") for one in wires]),
        "a floor to the horizon": (step, soft, [jr.Part(ball, "skin"), floor]),
    }
    rows, pictures = [], []
    for name, (sky, brdf, parts) in cases.items():
        camera = jr.Camera((0.1, 0.3, 2.2), (0, 0.1, 0), (0, 1, 0), 40, size, size)
        relighter = prepared(jr.Scene(parts, {"skin": brdf}, camera, name=name), tolerance=0.01)
        view = relighter.view()
        image = relighter.shade(relighter.light(jr.environment(sky.astype(np.float32))), view)
        plan, exact = image.measured["plan"], _exact(relighter, view, sky)
        one, other = (srgb_encode(to_unit(np.asarray(radiance))) for radiance in (image.radiance, exact))
        error, covered = np.abs(one - other).max(axis=2), np.asarray(view.surfaces.covered)
        rms = float(np.sqrt(np.mean((one - other)[covered] ** 2)))
        lost = int(np.count_nonzero(error > 0.25))
        pixels = covered.sum()
        figures = f"{plan.samples / pixels:.0f}", percent(plan.shaded / pixels), f"{rms:.4f}", f"{error.max():.2f}"
        rows.append([name, *figures, str(lost)])
        pictures.append(np.concatenate([one, np.repeat(np.clip(10 * error, 0, 1)[..., None], 3, axis=2)], axis=0))
    report.text(
        "Extremes, tolerance 0.01, with shadows: samples of a pixel, pixels shaded, root-mean-square error of "
        "displayed values against 1,024 filtered samples everywhere, and 64 directions in the sun's texel, the worst "
        "pixel's, and pixels that are off by more than a quarter."
    )
    report.table(["", "samples", "shaded", "error", "worst", "lost"], rows)
    if write:
        path = RESULTS.with_name("adaptive_extremes.png")
        jr.write_image(path, srgb_decode(np.concatenate(pictures, axis=1)).astype(np.float32))
        report.text(f"![Four extremes, and ten times their error]({path.name})")


def _exact(relighter: AdaptiveRelighter, view: AdaptiveView, sky: np.ndarray) -> np.ndarray:
    """Many samples everywhere; a sun is taken off by hand, and its texel cut into 64."""
    (row, column), (rows, columns) = np.unravel_index(sky[..., 0].argmax(), sky.shape[:2]), sky.shape[:2]
    largest, rest = sky.max(), np.where(sky > 1e3, 0.1, sky)
    relighter = dataclasses.replace(relighter, method=dataclasses.replace(relighter.method, seed=SEED))
    even = relighter.shade_uniform(relighter.light(jr.environment(rest.astype(np.float32))), view, 1024, filtered=True)
    if largest <= 1e3:
        return np.asarray(even)
    v, u = (
        (row + (np.indices((8, 8))[0].ravel() + 0.5) / 8) / rows,
        (column + (np.indices((8, 8))[1].ravel() + 0.5) / 8) / columns,
    )
    irradiance = np.full((64, 3), (largest - 0.1) * latlong.solid_angles(rows, columns)[row] / 64)
    sun = Sky(jax.numpy.asarray(latlong.directions(u, v), np.float32), jax.numpy.asarray(irradiance, np.float32))
    groups, points = group_lights([sun], relighter.geometry.surfaces.centre), view.surfaces.points
    by_sun = shade_lights(relighter.materials, view.surfaces, groups, trace_visibility(points, groups))
    return np.asarray(even) + np.asarray(by_sun)


def turned(x: float) -> np.ndarray:
    """A plane that is upright, and x to the right."""
    return np.array([[1, 0, 0, x], [0, 0, -1, 0.2], [0, 1, 0, 0], [0, 0, 0, 1.0]])


def measured_variance(case: Case, samples: int = 1024) -> np.ndarray:
    """Of what single samples say, at the pixels that are predicted."""
    part, probe = case.relighter().sampled_materials[0].components[0].sampler, case.view.probes[0]
    numbers = vogel_points(jax.numpy.arange(samples), jax.numpy.asarray(samples), jax.numpy.zeros(2, np.uint32))

    @jax.jit
    def of(part, light, pixels):
        def pixel(given):
            frame, omega_o, uv, footprint = given
            point = part.towards(omega_o, uv, footprint)

            def sample(number):
                drawn = point.draw(number)
                return (drawn.weight * light.radiance_at(drawn.omega_i @ frame)).mean()

            return jax.numpy.var(jax.vmap(sample)(numbers))

        rows = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint
        return jax.lax.map(pixel, rows, batch_size=256)

    return np.asarray(of(part, case.lit.mipmap, probe.pixels))


def interior(covered: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Covered pixels 16 or more from what is not."""
    return ndimage.binary_erosion(covered, iterations=16)


def windowed_frequencies(
    image: Float[np.ndarray, "h w"], covered: Bool[np.ndarray, "h w"], pixel: np.ndarray
) -> tuple[Bool[np.ndarray, " p"], Float[np.ndarray, "2 p"]]:
    """Where the whole window is covered, and its frequencies in cycles per pixel.

    The root mean square of all, and the quantile of 95 % of those but the mean's.
    """
    half, (h, w) = WINDOW // 2, covered.shape
    y, x = pixel // w, pixel % w
    inside = (y >= half) & (y < h - half) & (x >= half) & (x < w - half)
    hann = np.hanning(WINDOW)[:, None] * np.hanning(WINDOW)
    radius = np.hypot(*np.meshgrid(*[np.fft.fftfreq(WINDOW)] * 2, indexing="ij")).ravel()
    order = np.argsort(radius)
    frequencies, ok = np.zeros((2, len(pixel))), np.zeros(len(pixel), bool)
    for i in np.flatnonzero(inside):
        part = np.s_[y[i] - half : y[i] + half, x[i] - half : x[i] + half]
        if not covered[part].all():
            continue
        values = image[part]
        mean = (hann * values).sum() / hann.sum()
        energy = np.abs(np.fft.fft2(hann * (values - mean))).ravel() ** 2
        of_mean = WINDOW**2 * mean**2 * np.sum(hann**2)
        total = np.cumsum(energy[order])
        frequencies[0, i] = np.sqrt(np.sum(radius**2 * energy) / (of_mean + total[-1]))
        frequencies[1, i] = radius[order][np.searchsorted(total, 0.95 * total[-1])]
        ok[i] = total[-1] > 0
    return ok, frequencies


def windowed(values: np.ndarray, pixel: np.ndarray, shape: tuple[int, int]) -> Float[np.ndarray, " n"]:
    """Root mean square of what is known of some pixels in the window around each, weighted as its energy is."""
    hann, real = np.hanning(WINDOW + 1)[1:] ** 2, pixel < shape[0] * shape[1]

    def total(of):
        image = np.zeros(shape).ravel()
        image[pixel[real]] = of[real]
        across = ndimage.convolve1d(image.reshape(shape), hann, 0, mode="constant")
        return ndimage.convolve1d(across, hann, 1, mode="constant").ravel()

    return np.sqrt(total(np.square(values, dtype=float)) / np.maximum(total(np.ones(len(values))), 1e-9))


if __name__ == "__main__":
    main()
