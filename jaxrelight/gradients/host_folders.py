"""Entries of `jaxrelight.images`, `files`, `scene`, `precomputation` and `commands`: host code."""

from jaxrelight.gradients.entry import FILES, HOST, PRECOMPUTATION, Entries, Exempt, named

ENTRIES: Entries = (
    Exempt(
        (
            *named("jaxrelight.files.array_file", "encode_arrays decode_arrays"),
            *named("jaxrelight.files.class_record", "to_fields from_fields restored"),
            *named("jaxrelight.files.npz", "read_npz"),
            *named("jaxrelight.files.store", "Layer.write Layer.read Layer.read_groups Layer.read_all"),
            *named("jaxrelight.files.toml_table", "Table.array Table.channels Table.numbers Table.not_negative"),
            *named("jaxrelight.images.encoded", "decode_encoded"),
            *named("jaxrelight.images.exr", "read_exr open_exr write_exr read_channels write_channels"),
            *named("jaxrelight.images.files", "read_image open_image decode_image write_image write_layers"),
            *named("jaxrelight.images.radiance_hdr", "decode_radiance encode_radiance"),
        ),
        FILES,
    ),
    Exempt(
        (
            *named("jaxrelight.images.false_colour", "false_colour"),
            *named("jaxrelight.images.metric", "image_error"),
            *named("jaxrelight.images.primaries", "to_rec709 to_xyz"),
            *named("jaxrelight.images.tone", "srgb_encode srgb_decode auto_exposure shown_pixels displayed"),
            *named("jaxrelight.images.tone", "tone_map to_unit to_bytes"),
            *named("jaxrelight.images.figures", "side_by_side log_bars"),
        ),
        "NumPy: what is done with pictures that are known; for losses write their formulas in `jax.numpy`",
    ),
    Exempt(
        (
            *named("jaxrelight.scene.demo_scene", "demo_scene evening_sky"),
            *named("jaxrelight.scene.framing", "framing lamp_for framing_camera"),
            *named("jaxrelight.scene.lights", "read_light"),
            *named("jaxrelight.scene.materials", "read_texture weighted made_light from_file place_texture"),
            *named("jaxrelight.scene.mesh_placement", "turned_up up_matrix placed"),
            *named("jaxrelight.scene.mesh_scene", "open_scene scene_of_mesh"),
            *named("jaxrelight.scene.parts", "missing_sets with_plain_materials"),
            *named("jaxrelight.scene.scene", "Scene.surfaces Scene.at_sensors Scene.eye Scene.with_plain_materials"),
            *named("jaxrelight.scene.scene_file", "load_scene load_lights file_parts"),
            *named("jaxrelight.scene.light_text", "check_writable_lights lights_text"),
            *named("jaxrelight.scene.scene_file", "load_camera"),
            *named("jaxrelight.scene.sensors", "read_sensors"),
            *named("jaxrelight.scene.surroundings", "file_lights file_camera"),
        ),
        HOST,
    ),
    Exempt(
        (
            *named("jaxrelight.precomputation.chosen_resolution", "with_resolution"),
            *named("jaxrelight.precomputation.cloud_layers", "make_indirect"),
            *named("jaxrelight.precomputation.groups", "complete"),
            *named("jaxrelight.precomputation.receiver_refinement", "refined stored_refinement"),
            *named("jaxrelight.precomputation.layer_files", "write_once made_once write_geometry write_lights"),
            *named("jaxrelight.precomputation.layer_files", "write_environment write_factor write_table factors_of"),
            *named("jaxrelight.precomputation.account", "account_of"),
            *named("jaxrelight.precomputation.layers", "make_layers check_terms_of"),
            *named("jaxrelight.precomputation.load", "load receivers_of read_factors read_spatial_factors"),
            *named("jaxrelight.precomputation.load", "read_factor read_texture"),
            *named("jaxrelight.precomputation.material_rows", "Gathers.rows Gathers.channels_of"),
            *named("jaxrelight.precomputation.placing", "PlacedMaterial.in_rows PlacedScene.receivers"),
            *named("jaxrelight.precomputation.placing", "PlacedScene.materials reflection_of place geometry_keys"),
            *named("jaxrelight.precomputation.precompute", "precompute check_scene"),
            *named("jaxrelight.precomputation.surface_albedo", "albedo_at_points"),
            *named("jaxrelight.precomputation.vertex_occlusion", "vertex_occlusion sensor_occlusion"),
            *named("jaxrelight.precomputation.vertex_occlusion", "stored_occlusion with_stored_vertices"),
        ),
        PRECOMPUTATION,
    ),
    Exempt(
        (
            *named("jaxrelight.commands.measure", "table_of"),
            *named("jaxrelight.commands.options", "LightOptions.lights ViewOptions.camera"),
            *named("jaxrelight.commands.pictures", "scene_to_prepare prepared shaded make_picture"),
            *named("jaxrelight.commands.pictures", "told_clipped describe"),
            *named("jaxrelight.commands.inverse_lamps", "told tables_of write_report"),
            *named("jaxrelight.commands.inverse_light", "told lines_of"),
            *named("jaxrelight.commands.inverse_materials", "told lines_of write_materials write_report"),
        ),
        "the command line",
    ),
)
