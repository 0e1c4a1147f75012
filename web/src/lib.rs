//! The web handle.
