// What a report says of a check: a row of the ledger, without films.

/** The row of a check. */
export function summarise(check) {
  const { number, step, predicted, reward_raw, margin, hack } = check;
  return {
    number,
    step,
    predicted,
    reward_raw,
    margin,
    hack,
    modified: check.modified.utility,
    unmodified: check.unmodified.utility,
    digests: [check.modified.digest, check.unmodified.digest],
    refused: check.verdict === "refuse",
  };
}
