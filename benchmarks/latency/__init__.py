"""How late a node's answer is, beside nodes that compute nothing, over real topics on one machine."""
