"""YAML in which a key that is named twice is an error."""

from typing import Any

import yaml


class UniqueKeyLoader(yaml.SafeLoader):
    """Safe loader that refuses a key named twice, of which plain YAML silently takes the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """One mapping; raises yaml.constructor.ConstructorError with the place of the second key."""
        keys = [key.value for key, _ in node.value]
        twice = sorted({str(key) for key in keys if keys.count(key) > 1})
        if twice:
            raise yaml.constructor.ConstructorError(None, None, f"key named twice: {', '.join(twice)}", node.start_mark)
        return super().construct_mapping(node, deep)
