"""One file for each command of `jaxrelight-fit`.

With --json a command prints one object on one line of standard output; without it, the same in words. Keys stay what
they are from version to version; new ones may come. Shares are 0 … 1, not rounded; null stands for what is not known.
A command that fails prints nothing there: one line on standard error says why, and the exit status is 1 (2 for a wrong
command line, 130 when it was interrupted).

    command          lafortune, factors, sbrdf
    versions         of jaxrelight, jax and embreex
    data             the file that was fitted to
    output           the file that was written
    report           pictures that were written, with --report
    seconds          by stage: load, fit, write, report, total
    residual         root mean square of fit − data over that of the data; weighted, where the command has a weight

lafortune: format (MERL, RGL or Cornell), weight, lobes, exponents (by lobe, then by channel), exponent_deviation (of
their logarithms), C_deviation (radians), held_out (as residual, of samples that took no part), by_angle {incident,
half, difference: residuals between multiples of 10 degrees}, albedo_error (the largest relative difference of
directional albedos), verdict (good, no_data, black, constant, uncertain, at_bound, poor, energy or held_out), meaning
(of that), samples, masked (those that are not finite), below (those with a direction below the surface).

factors: format, form, parametrisation, terms, resolution, bytes (of the maps in memory); with --refine, refined
{before, after: residuals at directions that took no part} and refining_steps.

sbrdf: texels, images, lobes, storage, bytes (of the file), levels (width and height of each), estimated_normals,
verdicts (texels by verdict), held_out_images, held_out {lambert, lobes: as residual, of images that took no part;
lambert is the best without lobes}.
"""
