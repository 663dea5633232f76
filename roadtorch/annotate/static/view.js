// Request the newest frame repeatedly; the server answers when there is a newer one.
const token = new URLSearchParams(location.search).get("token") ?? "";
const frame = document.getElementById("frame"), status = document.getElementById("status");

let after = "";
for (;;) {
  let answer;
  try {
    answer = await fetch(`/api/frame?after=${after}`, { headers: { "X-Token": token } });
  } catch {
    status.textContent = "roadtorch has stopped.";
    break;
  }
  if (answer.status === 204) continue;
  if (!answer.ok) {
    status.textContent = answer.status === 410 ? "That was the last frame." : (await answer.json()).error;
    break;
  }
  const trust = answer.headers.get("X-Trust"), rate = answer.headers.get("X-Rate");
  after = answer.headers.get("X-Number");
  const last = frame.src;
  frame.src = URL.createObjectURL(await answer.blob());
  frame.hidden = false;
  await frame.decode().catch(() => {});
  if (last) URL.revokeObjectURL(last);
  status.textContent = [
    `frame ${answer.headers.get("X-Frame")}`, trust && `trust ${trust}`, rate && `${rate} frames per second`,
  ].filter(Boolean).join(" · ");
}
