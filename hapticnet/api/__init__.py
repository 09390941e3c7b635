"""The API of ``import hapticnet``. Import the names from `hapticnet` itself; docs/refer/api.md describes them."""
