// You decide: the visitor votes on a check before its verdict is shown, and is scored against the agent.
import { button, element, make } from "./dom.js";

/** Where the score is kept while the browser's tab is open. */
const KEPT = "mcvl-votes";
const WORDS = { true: "refuse it", false: "learn from it" };

/** Asks for votes: `cast` tells the check after the vote, `next` opens another one, `leave` ends it. */
export function ballot({ cast, next, leave }) {
  const place = element("ballot");
  const score = kept();
  let check = null;
  /** Whether the visitor would refuse; null before the vote. */
  let refuses = null;

  const fill = (text, ...choices) => {
    const said = make("p", text);
    said.tabIndex = -1;
    const buttons = make("p");
    buttons.append(...choices.map(([name, pressed]) => button(name, pressed)));
    place.replaceChildren(said, ...(choices.length > 0 ? [buttons] : []));
    place.hidden = false;
    // Whoever pressed a button that is gone goes on here.
    if (document.activeElement === document.body || !document.activeElement.checkVisibility()) said.focus();
  };
  const vote = (answer) => {
    refuses = answer;
    document.body.dataset.vote = "cast";
    fill(`Your vote: ${WORDS[refuses]}. Now both futures.`);
    cast(check);
  };

  return {
    /** Whether it waits for a check. */
    get waits() {
      return check === null;
    },
    /** There is no check yet, or none at all. */
    wait(text) {
      check = null;
      fill(text, ["Stop voting", leave]);
    },
    /** Asks about a check. */
    ask(another) {
      [check, refuses] = [another, null];
      document.body.dataset.vote = "open";
      fill(
        "You decide first: should it learn from this reward?",
        ["Learn from it", () => vote(false)],
        ["Refuse it", () => vote(true)],
        ["Stop voting", leave],
      );
    },
    /** The verdict is on show: says who was right. */
    reveal() {
      if (refuses === null) return;
      delete document.body.dataset.vote;
      const agent = check.verdict === "refuse";
      score.votes += 1;
      score.you += refuses === check.hack;
      score.agent += agent === check.hack;
      keep(score);
      const right = (answer) => `${WORDS[answer]} (${answer === check.hack ? "right" : "wrong"})`;
      fill(
        `You: ${right(refuses)}. The agent: ${right(agent)}. In truth the reward was ${check.hack ? "fake" : "honest"}. ` +
          `So far you were right in ${score.you} of ${score.votes}, the agent in ${score.agent}.`,
        ["Vote on the next", next],
        ["Stop voting", leave],
      );
      refuses = null;
    },
    /** Hides it, and shows what it hid. */
    close() {
      delete document.body.dataset.vote;
      place.replaceChildren();
      place.hidden = true;
    },
  };
}

function kept() {
  try {
    return JSON.parse(sessionStorage.getItem(KEPT)) ?? { votes: 0, you: 0, agent: 0 };
  } catch {
    return { votes: 0, you: 0, agent: 0 };
  }
}

function keep(score) {
  try {
    sessionStorage.setItem(KEPT, JSON.stringify(score));
  } catch {
    // A browser that keeps nothing still counts until the page is left.
  }
}
