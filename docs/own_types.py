"""Documentation: every parameter has the type and the default of its own annotation.

griffe gives parameters that share an entry of a docstring those of the first of them.
"""

from griffe import Class, DocstringSectionKind, Extension, Function, Module, Object


class OwnTypes(Extension):
    """Runs over what is documented once it is loaded, dataclasses included."""

    def on_package(self, *, pkg: Module, **_: object) -> None:
        """Mend every function and class of a package."""
        self._mend(pkg)

    def _mend(self, parent: Object) -> None:
        for member in parent.members.values():
            if member.is_alias:
                continue
            if isinstance(member, Function | Class):
                _mend_parameters(member)
            if isinstance(member, Module | Class):
                self._mend(member)


def _mend_parameters(member: Function | Class) -> None:
    if member.docstring is None:
        return
    own = {parameter.name: parameter for parameter in member.parameters}
    annotations = [parameter.annotation for parameter in own.values()]
    for section in member.docstring.parsed:
        if section.kind is not DocstringSectionKind.parameters:
            continue
        for shown in section.value:
            if shown.name in own:
                shown.value = own[shown.name].default
                if any(shown.annotation is each for each in annotations):  # not the docstring's
                    shown.annotation = own[shown.name].annotation
