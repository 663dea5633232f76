"""Sources of images and frames: files, videos, cameras, streams, bags."""
