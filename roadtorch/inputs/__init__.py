"""Where items come from: images, videos, cameras, streams, bags."""
