"""The pictures of a fruit as the report holds them: inside the page, with links to their files."""

from pipeline.batch.layout import FruitResults, Results
from reports.entries import FruitPictures, Picture

MANY = 450
"""Most fruit with pictures in the page; beyond it the page has links alone, since pictures of 500 take 25
MB."""
MANY_SCENES = 100
"""Most fruit with scenes in three dimensions in the page, which take 56 kB each in base64: 5.6 MB. Set by
hand."""


def fruit_pictures(
    results: Results, files: FruitResults, *, fruits: int, measured: bool = True
) -> FruitPictures:
    """Pictures of one fruit in a batch of `fruits`; none of one without a mesh (not `measured`)."""
    paths = {
        "photo": files.photo,
        "outlines": files.outlines,
        "mesh": files.picture,
        "surface_sd": files.surface_sd,
    }
    inside = {"photo", "mesh", "surface_sd"} if fruits <= MANY else set[str]()
    root = results.root.absolute()
    pictures = {
        name: Picture(
            content=path.read_bytes() if name in inside else b"",
            file=path.absolute().relative_to(root).as_posix(),
        )
        for name, path in paths.items()
        if measured and path.is_file()
    }
    turned = measured and fruits <= MANY_SCENES and files.scene.is_file()
    return FruitPictures(**pictures, scene=files.scene.read_bytes() if turned else b"")
