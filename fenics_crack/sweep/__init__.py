"""Many cases of a scene, spread over ranks."""
