"""Pictures for people: overlays, correspondences, films, recordings."""
