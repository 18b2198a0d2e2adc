"""Import contracts that import-linter does not bring: packages are entered by their doors, and in one direction."""

from graphlib import CycleError, TopologicalSorter
from typing import Any

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output


def rooms(graph: ImportGraph) -> set[str]:
    """The packages of the graph: every module that has modules inside."""
    return {module.rpartition(".")[0] for module in graph.modules if "." in module}


class DoorsContract(Contract):
    """What is inside a package is imported from outside only through the package itself, whose imports it hands on.

    The modules directly in one of the `floors` stand in the open. `open_packages` have no door because nothing but
    programs starts there. `namespaces` are modules that a door hands out whole: tables of functions that read best with
    the module's name before them.
    """

    type_name = "doors"

    floors = fields.SetField(subfield=fields.StringField())
    open_packages = fields.SetField(subfield=fields.StringField(), required=False)
    namespaces = fields.SetField(subfield=fields.StringField(), required=False)

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """Every import from outside of a package that goes past its door."""
        packages = rooms(graph)
        spared = {*packages, *(self.namespaces or ())}
        without_door = {"", *self.floors, *(self.open_packages or ())}
        past: list[dict[str, Any]] = []
        for imported in sorted(graph.modules - spared):
            door = imported.rpartition(".")[0]
            if door in without_door:
                continue
            for importer in sorted(graph.find_modules_that_directly_import(imported)):
                if importer != door and importer.rpartition(".")[0] != door:
                    details = graph.get_import_details(importer=importer, imported=imported)
                    past.append({"importer": importer, "line": details[0]["line_number"], "imported": imported})
        return ContractCheck(kept=not past, metadata={"past": past})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """One line an import, with the door that it should have taken."""
        for row in check.metadata["past"]:
            door = row["imported"].rpartition(".")[0]
            output.print_error(f"{row['importer']}:{row['line']} imports {row['imported']}; its door is {door}")


class FoldersContract(Contract):
    """Folders import one another in one direction: no package comes back to itself through others, parents included."""

    type_name = "folders"

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """The first circle of packages, if there is one."""
        packages = rooms(graph)
        below: dict[str, set[str]] = {package: set() for package in packages}
        for importer in graph.modules:
            here = importer if importer in packages else importer.rpartition(".")[0]
            for imported in graph.find_modules_directly_imported_by(importer):
                there = imported if imported in packages else imported.rpartition(".")[0]
                if here in packages and there in packages and here != there:
                    below[here].add(there)
        try:
            TopologicalSorter(below).prepare()
        except CycleError as error:
            return ContractCheck(kept=False, metadata={"circle": error.args[1]})
        return ContractCheck(kept=True)

    def render_broken_contract(self, check: ContractCheck) -> None:
        """The circle, from its first package back to it."""
        output.print_error(" <- ".join(check.metadata["circle"]))
