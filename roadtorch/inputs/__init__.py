"""Where items come from: pictures, archives, URLs, videos, cameras, streams, bags."""
