//! The repository's own text files, as the tidy rules read them.

use std::fs;
use std::path::Path;

use crate::root;

/// Folders that are made, not written.
const MADE: &[&str] = &["target", "third_party", "node_modules", "pkg"];
/// ... at the root; elsewhere there are rooms of this name.
const MADE_AT_ROOT: &str = "runs";
/// Hidden folders that belong to the repository.
const HIDDEN: &[&str] = &[".cargo", ".ci", ".config"];

/// A text file of the repository.
pub struct SourceFile {
    /// Path from the root, with `/`.
    pub path: String,
    /// Content.
    pub text: String,
}

impl SourceFile {
    /// Whether the name ends with one of these extensions.
    pub fn is(&self, extensions: &[&str]) -> bool {
        self.path.rsplit_once('.').is_some_and(|(_, extension)| extensions.contains(&extension))
    }

    /// What is compiled or run, line by line with numbers: without comments, and without the test module
    /// with which a Rust file may end.
    pub fn code(&self) -> impl Iterator<Item = (usize, &str)> {
        let lines: Vec<&str> = self.text.lines().collect();
        let is_tests =
            |pair: &[&str]| pair[0] == "#[cfg(test)]" && pair[1].starts_with("mod ") && pair[1].ends_with('{');
        let end = lines.windows(2).position(is_tests).unwrap_or(lines.len());
        lines.into_iter().take(end).zip(1..).map(|(line, number)| (number, without_comment(line)))
    }
}

/// A line up to `//`, unless that stands in a string (`://` of an address is no comment either).
fn without_comment(line: &str) -> &str {
    let mut quoted = false;
    let mut before = [' ', ' '];
    for (index, character) in line.char_indices() {
        match character {
            '"' if before[1] != '\\' && before != ['\'', '"'] => quoted = !quoted,
            '/' if before[1] == '/' && !quoted && before[0] != ':' => return &line[..index - 1],
            _ => {}
        }
        before = [before[1], character];
    }
    line
}

/// Every text file of the repository, sorted by path.
///
/// # Panics
/// If the repository cannot be read.
pub fn files() -> Vec<SourceFile> {
    let mut found = Vec::new();
    collect(root(), &mut found);
    found.sort_by(|a, b| a.path.cmp(&b.path));
    assert!(found.iter().any(|file| file.path == "core/src/lib.rs"), "{} is not the repository", root().display());
    found
}

fn collect(folder: &Path, found: &mut Vec<SourceFile>) {
    for entry in fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display())) {
        let path = entry.expect("a folder can be listed").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() {
            let hidden = name.starts_with('.') && !HIDDEN.contains(&name.as_str());
            let made = MADE.contains(&name.as_str()) || path == root().join(MADE_AT_ROOT);
            if !hidden && !made {
                collect(&path, found);
            }
        } else if name == ".git" {
            // A linked worktree has a file there, with a path of its machine; it is not committed.
        } else if let Ok(text) = fs::read_to_string(&path) {
            let relative = path.strip_prefix(root()).expect("it was found below the root");
            found.push(SourceFile { path: relative.to_string_lossy().replace('\\', "/"), text });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_test_modules_are_left_out() {
        let text = "a // b\n#[cfg(test)]\nmod x;\nc(\"//\") /// d\n\"https://e\" // f\n#[cfg(test)]\nmod tests {\ng\n}";
        let file = SourceFile { path: "x.rs".into(), text: text.into() };
        let code: Vec<_> = file.code().collect();
        assert_eq!(code, [(1, "a "), (2, "#[cfg(test)]"), (3, "mod x;"), (4, "c(\"//\") "), (5, "\"https://e\" ")]);
        assert!(file.is(&["rs"]) && !file.is(&["js"]));
    }
}
