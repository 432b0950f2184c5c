"""MTL libraries: what their statements and the options of their images mean."""

import pathlib

import pytest

from jaxrelight.geometry.file_materials import FileMaterial, FilePicture
from jaxrelight.geometry.mtl import read_mtl


def material(text: str, folder: pathlib.Path = pathlib.Path()) -> FileMaterial:
    (only,) = read_mtl(f"newmtl a\n{text}\n", folder).values()
    return only


def test_names_keep_hashes_and_spaces():
    names = "Rough Grey #1", "Rough Grey #2", "a#b", "größe 2"
    text = "\ufeff# a comment\n" + "\n".join(f"newmtl {name}\n\tKd 0.{i + 1}  # grey" for i, name in enumerate(names))
    read = read_mtl(text, pathlib.Path())
    assert list(read) == list(names)
    assert [one.diffuse[0] for one in read.values()] == [0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize(
    ("text", "specular", "noted"),
    [
        ("Ks .5 .5 .5\nNs 50\nillum 2", 0.5, False),
        ("Ks .5 .5 .5\nNs 50", 0.5, False),
        ("illum 1\nKs .5 .5 .5\nNs 50", 0.0, False),
        ("Ks .5 .5 .5\nNs 50\nillum 0", 0.0, False),
        ("Ks 1 1 1\nNs 0\nTf 0 0 0", 0.0, True),
        ("Ks 1 1 1", 0.0, True),
    ],
)
def test_highlights(text: str, specular: float, noted: bool):
    read = material(text)
    assert read.specular == (specular,) * 3
    assert bool(read.notes) == noted


def test_emission_may_exceed_1():
    assert material("Ke 3 1.5 0").emission == (3.0, 1.5, 0.0)
    assert material("map_Ke glow.png").emission == (1.0, 1.0, 1.0)


def test_metals_of_the_extension_for_physically_based_materials():
    gold = material("Kd 1 .8 .3\nPm 1\nPr 0.3")
    assert gold.diffuse == (0.0, 0.0, 0.0)
    assert gold.specular == (1.0, 0.8, 0.3)
    assert gold.exponent > 10


@pytest.mark.parametrize(
    ("words", "name", "placement", "wrap", "scale"),
    [
        ("wood.png", "wood.png", None, "repeat", 1.0),
        ("my wood #2.png", "my wood #2.png", None, "repeat", 1.0),
        ("-s .5 .25 1 wood.png", "wood.png", ((0.5, 0.0, 0.0), (0.0, 0.25, 0.0)), "repeat", 1.0),
        ("-s 2 wood.png", "wood.png", ((2.0, 0.0, 0.0), (0.0, 1.0, 0.0)), "repeat", 1.0),
        ("-o 0.5 0.5 0 -s .5 .5 1 t.png", "t.png", ((0.5, 0.0, 0.5), (0.0, 0.5, 0.5)), "repeat", 1.0),
        ("-clamp on -bm 0.3 a b.png", "a b.png", None, "clamp", 0.3),
        ("wood.png -clamp on", "wood.png", None, "clamp", 1.0),
        ("-blendu on -blendv off -boost 2 wood.png", "wood.png", None, "repeat", 1.0),
        ("2d.png", "2d.png", None, "repeat", 1.0),
        ("-bm 1 2 3.png", "2 3.png", None, "repeat", 1.0),
    ],
)
def test_options_of_images(words: str, name: str, placement, wrap: str, scale: float):
    read = material(f"map_Bump {words}")
    assert read.bump_picture == FilePicture(pathlib.Path(name), placement=placement, wrap=(wrap, wrap))  # pyright: ignore[reportArgumentType]
    assert read.normal_scale == scale
    assert not read.notes


def test_options_that_are_left_out_are_told():
    assert "-mm -imfchan of the image wood.png are left out" in material("map_Kd -mm 0 2 -imfchan r wood.png").notes[0]


def test_images_are_found_as_people_leave_them(tmp_path: pathlib.Path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "Wood Grain.PNG").write_bytes(b"x")
    (tmp_path / "flat.png").write_bytes(b"x")
    for written in ("maps/Wood Grain.PNG", "maps\\Wood Grain.PNG", "./maps/Wood Grain.PNG", '"maps/Wood Grain.PNG"'):
        read = material(f"map_Kd {written}", tmp_path)
        assert read.diffuse_picture is not None
        assert pathlib.Path(str(read.diffuse_picture.source)).read_bytes() == b"x"
    for written in ("maps/wood grain.png", "C:\\Users\\me\\maps\\Wood Grain.PNG", "/home/me/flat.png", "D:/x/FLAT.png"):
        read = material(f"map_Kd {written}", tmp_path)
        assert read.diffuse_picture is not None
        assert pathlib.Path(str(read.diffuse_picture.source)).read_bytes() == b"x"
        assert "is taken from" in read.notes[0]
    missing = material("map_Kd C:\\me\\none.png", tmp_path).diffuse_picture
    assert missing is not None
    assert missing.source == tmp_path / "none.png"


def test_lines_that_make_no_sense_are_told():
    read = material("Kd red\nKs nan 0 0\nmap_Kd\nd 0.5\nTr 0.5\ndisp d.png\nmap_Pr r.png\nNi 1.5\nKa 1 1 1")
    assert sum("is not understood" in note for note in read.notes) == 3
    assert read.notes.count("transparency is left out; it is opaque") == 1
    assert "displacement maps are left out" in read.notes
    assert "'map_pr' of the library is left out" in read.notes
    assert len(read.notes) == 6
