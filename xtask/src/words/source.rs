//! The texts of Rust source that users read: string literals, and documentation, of which clap makes help.

use std::ops::Range;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Code,
    Literal,
    Documentation,
    /// A comment or a character.
    Other,
}

struct Piece<'a> {
    kind: Kind,
    start: usize,
    text: &'a str,
}

/// The texts outside test items in lower case, each with the number of the line where it begins. Documentation is left out
/// unless `with_help`.
pub(super) fn texts(source: &str, with_help: bool) -> Vec<(usize, String)> {
    let pieces = pieces(source);
    let tests = test_items(&code_only(&pieces));
    pieces
        .iter()
        .filter(|piece| !tests.iter().any(|item| item.contains(&piece.start)))
        .filter_map(|piece| {
            let text = match piece.kind {
                Kind::Literal => without_formats(piece.text),
                Kind::Documentation if with_help => piece.text.trim_start_matches('/').to_owned(),
                _ => return None,
            };
            let line = source[..piece.start].matches('\n').count() + 1;
            Some((line, text.to_lowercase()))
        })
        .collect()
}

fn pieces(source: &str) -> Vec<Piece<'_>> {
    let mut pieces = Vec::new();
    let mut start = 0;
    while start < source.len() {
        let (kind, length) = first_piece(&source[start..]);
        let text = &source[start..start + length];
        pieces.push(Piece { kind, start, text });
        start += length;
    }
    pieces
}

/// The kind and the length of the piece with which `source` begins.
fn first_piece(source: &str) -> (Kind, usize) {
    if source.starts_with("//") {
        let kind = if source.starts_with("///") { Kind::Documentation } else { Kind::Other };
        return (kind, source.find('\n').unwrap_or(source.len()));
    }
    if source.starts_with("/*") {
        return (Kind::Other, source.find("*/").map_or(source.len(), |end| end + 2));
    }
    if let Some(length) = raw_string(source).or_else(|| quoted(source, '"')) {
        return (Kind::Literal, length);
    }
    if let Some(length) = character(source) {
        return (Kind::Other, length);
    }
    (Kind::Code, source.chars().next().map_or(0, char::len_utf8))
}

/// The length of the raw string with which `source` begins.
fn raw_string(source: &str) -> Option<usize> {
    let rest = source.strip_prefix('r')?;
    let hashes = &rest[..rest.find(|c| c != '#')?];
    let body = rest[hashes.len()..].strip_prefix('"')?;
    let end = format!("\"{hashes}");
    Some(source.len() - body.len() + body.find(&end)? + end.len())
}

/// The length of the text in quotes with which `source` begins.
fn quoted(source: &str, quote: char) -> Option<usize> {
    let mut is_escaped = false;
    let length = source.strip_prefix(quote)?.find(|c: char| {
        let ends = c == quote && !is_escaped;
        is_escaped = c == '\\' && !is_escaped;
        ends
    })?;
    Some(length + 2)
}

/// The length of the character with which `source` begins. A lifetime is none.
fn character(source: &str) -> Option<usize> {
    let mut after = source.strip_prefix('\'')?.chars();
    let is_character = after.next()? == '\\' || after.next()? == '\'';
    if is_character { quoted(source, '\'') } else { None }
}

/// The code with spaces in place of everything else, so that positions are kept.
fn code_only(pieces: &[Piece<'_>]) -> String {
    let parts = pieces.iter().map(|piece| match piece.kind {
        Kind::Code => piece.text.to_owned(),
        _ => " ".repeat(piece.text.len()),
    });
    parts.collect()
}

/// Where the items are that are compiled for tests only.
fn test_items(code: &str) -> Vec<Range<usize>> {
    const ATTRIBUTE: &str = "#[cfg(test)]";
    let starts = code.match_indices(ATTRIBUTE).map(|(start, _)| start);
    starts
        .map(|start| {
            let item = start + ATTRIBUTE.len();
            start..item + item_length(&code[item..])
        })
        .collect()
}

/// The length of the item with which `code` begins. It ends with a semicolon, with its braces, or with what it is part of.
fn item_length(code: &str) -> usize {
    let mut depth = 0;
    for (at, c) in code.char_indices() {
        match c {
            '(' | '[' | '{' => depth += 1,
            ')' | ']' | '}' => depth -= 1,
            _ => {}
        }
        if depth < 0 || depth == 0 && matches!(c, ';' | '}') {
            return at + 1;
        }
    }
    code.len()
}

/// A literal in one line, without names in braces. A text without a space is a key or an option, which is a format.
fn without_formats(literal: &str) -> String {
    let literal = literal.replace("\\\n", " ").replace("\\n", " ");
    if !literal.contains(' ') {
        return String::new();
    }
    let parts = literal.split('{').map(|part| part.split_once('}').map_or(part, |(_, rest)| rest));
    parts.collect::<String>().split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn without_help(source: &str) -> Vec<String> {
        texts(source, false).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn strings_are_read_and_comments_keys_and_names_in_braces_are_not() {
        assert_eq!(without_help(r#"let x = f("A b"); // "c d""#), ["\"a b\""]);
        assert_eq!(without_help(r#"    // "nobody is here""#), [""; 0]);
        assert_eq!(without_help("f(\"pictures\", \"--pictures\")"), ["", ""]);
        assert_eq!(without_help("f(\"of {pictures} frames\")"), ["\"of frames\""]);
    }

    #[test]
    fn documentation_is_read_only_as_help() {
        assert_eq!(texts("/// Nobody is here.", true), [(1, " nobody is here.".to_owned())]);
        assert_eq!(texts("/// Nobody is here.", false), []);
        assert_eq!(texts("// Nobody is here.", true), []);
    }

    #[test]
    fn a_string_of_several_lines_is_one_text_on_the_line_where_it_begins() {
        let source = "x();\nf(\n    \"it goes on by \\\n     itself\",\n    \"a\\\" b\",\n);\n";
        let expected = [(3, "\"it goes on by itself\""), (5, "\"a\\\" b\"")];
        assert_eq!(texts(source, false), expected.map(|(line, text)| (line, text.to_owned())));
    }

    #[test]
    fn raw_strings_are_read_to_their_end() {
        let source = "f(r#\"a \"quoted\"\nword\"#, r\"b\\\", \"c d\")";
        assert_eq!(without_help(source), ["r#\"a \"quoted\" word\"#", "", "\"c d\""]);
    }

    #[test]
    fn quotes_and_braces_in_characters_and_lifetimes_do_not_begin_a_string() {
        let source = r#"f('"', '\'', '\\', "a b"); fn g<'a>(_: &'a str) { h("c d") }"#;
        assert_eq!(without_help(source), ["\"a b\"", "\"c d\""]);
    }

    #[test]
    fn only_the_item_after_the_attribute_is_left_out() {
        let source = r#"
            #[cfg(test)]
            pub(crate) use exploration::{log_agreement, other};
            const A: &str = "after an import";
            #[cfg(test)]
            #[path = "x tests.rs"]
            mod x_tests;
            fn b() { f("after a module in a file") }
            #[cfg(test)]
            fn c(_: [u8; 2]) -> [&str; 1] { if '}' == '{' { "in } a" } else { "in b" } }
            const D: &str = "after a function";
            struct E { #[cfg(test)] f: u8 }
            const G: &str = "after a field";
            #[cfg(test)]
            mod tests { fn h() { f("in a module") } }
        "#;
        let expected = [
            "\"after an import\"",
            "\"after a module in a file\"",
            "\"after a function\"",
            "\"after a field\"",
        ];
        assert_eq!(without_help(source), expected);
    }
}
