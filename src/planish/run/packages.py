"""The installed packages that a study needs beside planish, for what it names of theirs."""

from importlib.metadata import PackageNotFoundError, version

from planish.core.errors import InputError
from planish.core.plugins import plugins
from planish.io import find_place
from planish.io.formats import format_of
from planish.measure import registered
from planish.run.study import Study


def with_packages(study: Study) -> Study:
    """Name the packages whose properties and formats a study names, as they are installed."""
    packages: dict[str, str] = {}
    for layer in study.layers:
        if layer.volume is None:
            continue
        for plugin in plugins("property"):
            prop = registered().get(plugin.name)
            is_theirs = prop is None or not prop.function.__module__.startswith("planish.")
            if is_theirs and plugin.name in layer.properties.maps:
                packages[plugin.package] = plugin.version
        reader = format_of(find_place(layer.volume.path)).plugin
        if reader is not None:
            packages[reader.package] = reader.version
    return study.model_copy(update={"packages": packages})


def check_packages(study: Study) -> None:
    """Raise InputError for a package that gave what a study names, and is not installed."""
    for package, old_version in study.packages.items():
        try:
            version(package)
        except PackageNotFoundError:
            raise InputError(
                f"The run was made with the package {package} {old_version}, which is not"
                f' installed. Run: pip install "{package}=={old_version}". Or take what it gives'
                " out of the study, and its line under [packages]."
            ) from None
