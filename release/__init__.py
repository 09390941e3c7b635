"""What the owner builds and publishes: `make release`, `make publish`. CONTRIBUTING.md says how."""
