"""Figures of positioning by a phone's motion sensors and radios, on recorded phones."""
