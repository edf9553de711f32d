"""For all packages: errors, units, tables of files, TOML, output folders, HTML, drawing, cache."""

__all__: list[str] = []
