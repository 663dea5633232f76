// Caches the page's files, so that it opens offline after the first visit.
const NAME = "roadtorch VERSION", FILES = [];

self.addEventListener("install", (event) =>
  event.waitUntil(caches.open(NAME).then((cache) => cache.addAll(FILES)).then(() => self.skipWaiting())));

self.addEventListener("activate", (event) =>
  event.waitUntil((async () => {
    for (const name of await caches.keys()) if (name.startsWith("roadtorch ") && name !== NAME) await caches.delete(name);
    await self.clients.claim();
  })()));

self.addEventListener("fetch", (event) =>
  event.respondWith(caches.open(NAME).then((cache) => cache.match(event.request)).then((cached) => cached ?? fetch(event.request))));
