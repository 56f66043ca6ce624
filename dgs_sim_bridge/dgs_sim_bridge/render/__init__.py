"""Pictures of the world from meshes: rasteriser, camera noise, object model. Needs numpy and scipy only."""
