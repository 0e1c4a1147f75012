// What a report says of a check: a row of the ledger, without films.

/** The row of a check. */
export function summarise(check) {
  const { number, step, predicted, reward_raw, margin, hack } = check;
  const refused = check.verdict === "refuse";
  return {
    number,
    step,
    predicted,
    reward_raw,
    margin,
    hack,
    // A discard has no futures.
    modified: check.modified?.utility,
    unmodified: check.unmodified?.utility,
    digests: [check.modified?.digest, check.unmodified?.digest],
    refused,
    // Whether what we want of the future that learned is less.
    fell: check.modified?.performance < check.unmodified?.performance,
    // An update has a whole mini-batch, and no truth of its own.
    wrong: check.subject !== "update" && refused !== hack,
  };
}

/** Whether a decision that was made here has the bits of a recorded check. */
export function same(row, recorded) {
  const bits = ({ digests, modified, unmodified, refused }) => `${[digests, modified, unmodified, refused]}`;
  return bits(row) === bits(summarise(recorded));
}
