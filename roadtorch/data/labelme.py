"""Truth from drawn annotations: LabelMe's XML, labelme's JSON, one or several people.

XML as LabelMe and the tool of Álvarez et al. (arXiv 1412.3506, §4) store it: objects that
consist of polygons, each with the name of who drew it. JSON as the program labelme stores
it: a list of shapes. The files of one picture are all those that bear its name::

    NAME.xml     NAME.json           beside the picture or in ROOT/annotations
    USER/NAME.xml                    one folder for each person
    NAME.USER.xml                    one suffix for each person
"""

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path, PurePath

from PIL.ExifTags import Base as ExifTag

from roadtorch.data.annotations import Drawing, read_annotation
from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.data.labels import is_picture
from roadtorch.data.polygons import OTHER, ROAD, VOID, Agreement, agree, filled_shapes
from roadtorch.errors import ConfigError, DatasetError
from roadtorch.io.bounded import read_regular, reason
from roadtorch.io.decoding import open_picture, without_warnings
from roadtorch.io.image import SUFFIXES

ENDINGS = (".xml", ".json")

AGREEMENTS = ("majority", "union", "intersection")

TURNED = (5, 6, 7, 8)  # EXIF orientations that swap width and height


@dataclass(frozen=True)
class PolygonLabels:
    """The truth in annotations of polygons.

    road, void: names of objects, lower case; every other object is not road, and cuts a
    hole into what was drawn before it. agreement: when several people drew, a pixel is
    road if most of them say so, any or all. user: listen to this person alone. root: the
    folder below which people have folders of their own, if they do.
    Raises ConfigError for an unknown agreement.
    """

    road: tuple[str, ...] = ("road",)
    void: tuple[str, ...] = ("void", "ignore")
    agreement: Agreement = "majority"
    user: str | None = None
    root: Path | None = None

    def __post_init__(self) -> None:
        if self.agreement not in AGREEMENTS:
            what, known = "unknown agreement", ", ".join(AGREEMENTS)
            raise ConfigError(self.agreement, what, f"known: {known}")

    def truth(self, item: Item) -> Truth:
        """Read, draw and combine the item's annotations; DatasetError naming the file."""
        size = picture_size(item.image)
        by_user: dict[str, list[Drawing]] = {}
        for path in (item.label, *item.extra):
            drawings = read_annotation(path, size)
            owner = file_user(path, item.name, self.root)
            if owner:  # all of it is theirs, were it nothing
                by_user.setdefault(owner, [])
            for part in drawings:
                by_user.setdefault(owner or part.user, []).append(part)
        if self.user is not None and self.user not in by_user:
            known = ", ".join(sorted(by_user)) or "nobody"
            what = f"has nothing from the user {self.user}"
            raise DatasetError(item.label, what, f"it was annotated by {known}")
        meanings = {**dict.fromkeys(self.void, VOID), **dict.fromkeys(self.road, ROAD)}
        said = {
            user: filled_shapes([(one.fill, meanings.get(one.name, OTHER)) for one in drawn], size)
            for user, drawn in by_user.items()
            if self.user in (None, user)
        }
        return agree(said, size, self.agreement)


# --- sizes ------------------------------------------------------------------------------


def picture_size(path: Path) -> tuple[int, int]:
    """(height, width) of a picture as it is shown, from its header.

    Raises DatasetError when it cannot be opened.
    """
    try:
        with open_picture(read_regular(path)) as picture, without_warnings():
            turned = picture.getexif().get(ExifTag.Orientation) in TURNED
            return (picture.width, picture.height) if turned else (picture.height, picture.width)
    except Exception as problem:
        raise DatasetError(
            path, f"cannot be opened: {reason(problem)}", "replace the file"
        ) from None


# --- finding the files ------------------------------------------------------------------


def file_user(path: Path, name: str, root: Path | None) -> str:
    """Whose file an annotation of the picture ``name`` is; "" if the file does not say."""
    stem = PurePath(name).name
    if path.stem != stem:
        return path.stem.removeprefix(f"{stem}.")
    if root is None or not path.is_relative_to(root):
        return ""
    folders = path.relative_to(root).parts
    return folders[0] if len(folders) > len(PurePath(name).parts) else ""


def open_labelme(root: Path, split: str, agreement: Agreement = "majority") -> Dataset:
    """Pictures in ROOT/images or ROOT, annotations in ROOT/annotations or beside them.

    Folders may be nested, and LabelMe's capital letters (Images, Annotations) do as well. A
    picture's group is its uppermost folder. Raises DatasetError for a folder without
    pictures, a picture without annotation, and two files of one person for one picture.
    """
    images, annotations = (
        next((root / one for one in names if (root / one).is_dir()), root)
        for names in (("images", "Images"), ("annotations", "Annotations"))
    )
    annotations = images if annotations == root else annotations
    pictures = _pictures(images)
    files = _files(annotations, set(pictures))
    missing = [name for name in pictures if name not in files]
    if missing:
        first = (annotations / missing[0]).with_name(f"{PurePath(missing[0]).name}.xml")
        what = f"is missing, and so is .json, {len(missing)} of {len(pictures)} annotations in all"
        raise DatasetError(first, what, "every picture needs its annotation, be it empty")
    items = tuple(
        Item(name, path, files[name][0], group, tuple(files[name][1:]))
        for name, path in pictures.items()
        for group in [name.partition("/")[0] if "/" in name else None]
    )
    reader = PolygonLabels(agreement=agreement, root=annotations)
    name = "labelme" if agreement == "majority" else f"labelme:{agreement}"
    return Dataset(name, root, split, items, reader)


def _pictures(folder: Path) -> dict[str, Path]:
    """Every picture below a folder by its relative name without ending, sorted."""
    found: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
        if is_picture(path):
            name = path.relative_to(folder).with_suffix("").as_posix()
            if name in found:
                what = f"has the name of {found[name].name}"
                raise DatasetError(path, what, "a name may have one picture")
            found[name] = path
    if not found:
        raise DatasetError(folder, "holds no pictures", f"known endings: {' '.join(SUFFIXES)}")
    return found


def _files(folder: Path, names: set[str]) -> dict[str, list[Path]]:
    """The annotation files of each picture; files that belong to none are passed over."""
    found: dict[str, dict[str, Path]] = defaultdict(dict)
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in ENDINGS or path.name.startswith("."):
            continue
        stem = path.relative_to(folder).with_suffix("").as_posix()
        suffixed = stem.rpartition(".")[0] if "." in PurePath(stem).name else stem
        name = next((one for one in (stem, stem.partition("/")[2], suffixed) if one in names), None)
        if name is None:
            continue
        user = file_user(path, name, folder)
        if user in found[name]:
            what = f"and {found[name][user].name} are both for the picture {name}"
            raise DatasetError(path, what, "give people folders of their own, or drop one")
        found[name][user] = path
    return {name: list(paths.values()) for name, paths in found.items()}
