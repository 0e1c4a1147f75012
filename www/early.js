// Asks for the recorded run that the link leads to before the page's modules are there: a round trip saved.
{
  const query = new URLSearchParams(location.search);
  const worlds = ["absent-supervisor", "tomato-watering", "rocks-and-diamonds", "reacher"];
  const world = worlds.find((name) => ["env=" + name, `env=${name}&seed=0`].includes(String(query)));
  // As `link.js` reads it; whatever else the link says is said there.
  const [tape] = query.get("tape")?.match(/^[\w-]+([./][\w-]+)*$/) ?? [];
  const name = tape ?? (world ? `tapes/${world}.json` : "tape.json");
  globalThis.early = { name, response: fetch(name) };
  // Whoever asks for it hears of that.
  globalThis.early.response.catch(() => {});
}
