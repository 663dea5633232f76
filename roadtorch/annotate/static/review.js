// Going through what another person called right, and the caution for who calls right too fast.

// Whose work on a picture is to be reviewed by a user: first what the user has not reviewed yet.
export function toReview(picture, user) {
  const others = Object.entries(picture?.users ?? {})
    .filter(([who, work]) => who !== user && work.confirmed);
  const open = others.find(([, work]) => !work.reviewed.includes(user));
  return (open ?? others[0])?.[0] ?? null;
}

// Whether a picture has work of another that waits for this user's verdict.
export function waits(picture, user) {
  return Object.entries(picture.users).some(([who, work]) => (
    who !== user && work.confirmed && !work.reviewed.includes(user)
  ));
}

// Calls the work right, takes that back, or reopens it: the act, or null where nothing was found.
export function verdict(state, user, right) {
  const confirmed = state?.events.findLast(([, kind]) => kind === "right");
  if (!confirmed) return null;
  return right ? { kind: "reviewed", of: confirmed[0], by: user }
    : { kind: "undo", of: confirmed[0], by: user };
}

// The review of a user taken back, if it is what was done last.
export function withdrawn(state, user) {
  const last = state?.events.at(-1);
  const own = last?.[1] === "reviewed" && state.reviewed.includes(user);
  return own ? { kind: "undo", of: last[0], by: user } : null;
}

export function caution(count) {
  return count ? ` · caution: ${count} in a row right in less than 1 s each; look again (k)` : "";
}
