"""ICT-FaceKit (MIT): people sampled from its identity modes, on the user's own clone."""
