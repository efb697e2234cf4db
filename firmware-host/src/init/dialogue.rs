//! Asks a person, on any terminal that is 40 columns wide or wider.

use std::io::{BufRead, Write};

use anyhow::{Result, bail};

use super::answers::{Answer, Answers, typed};
use super::found::Found;
use super::questions::{QUESTIONS, Question};
use crate::report::fit;

/// A conversation with one person.
pub struct Dialogue<'a> {
    input: &'a mut dyn BufRead,
    output: &'a mut dyn Write,
    columns: Option<usize>,
}

impl<'a> Dialogue<'a> {
    /// A conversation by lines, on a terminal of this many columns.
    pub fn new(
        input: &'a mut dyn BufRead,
        output: &'a mut dyn Write,
        columns: Option<usize>,
    ) -> Self {
        Self { input, output, columns }
    }

    /// Asks every question that applies, until each has an answer that is allowed.
    ///
    /// # Errors
    /// The input ended.
    pub fn ask_all(&mut self, found: &Found) -> Result<Answers> {
        let mut answers = Answers::default();
        let mut number = 0;
        for question in QUESTIONS {
            if question.applies(&answers) {
                number += 1;
                let answer = self.ask(number, question, found, &answers)?;
                answers.put(question.key, answer);
            }
        }
        Ok(answers)
    }

    fn ask(
        &mut self,
        number: usize,
        question: &Question,
        found: &Found,
        answers: &Answers,
    ) -> Result<Answer> {
        let default = question.default(found, answers);
        self.say("")?;
        self.say(&format!("{number:>2}.  {}", question.words))?;
        if !question.help.is_empty() {
            self.say(&format!("     {}", question.help))?;
        }
        for (place, option) in question.options(found).iter().enumerate() {
            self.say(&format!("     {})  {option}", place + 1))?;
        }
        let unit = question.allowed().map_or_else(String::new, |allowed| format!("{allowed} "));
        loop {
            let text = self.answer(&format!("     {unit}[{default}]: "))?;
            if text.is_empty() {
                return Ok(default);
            }
            match typed(question, &text, found, answers) {
                Ok(answer) => return Ok(answer),
                Err(why) => self.say(&format!("     !  {why}"))?,
            }
        }
    }

    /// Shows a line, broken to the width of the terminal.
    ///
    /// # Errors
    /// The output is closed.
    pub fn say(&mut self, line: &str) -> Result<()> {
        Ok(writeln!(self.output, "{}", fit::text(line, self.columns))?)
    }

    /// Waits for a line behind a prompt, without the spaces around it.
    ///
    /// # Errors
    /// The input ended.
    pub fn answer(&mut self, prompt: &str) -> Result<String> {
        write!(self.output, "{}", fit::text(prompt.trim_end(), self.columns))?;
        write!(self.output, " ")?;
        self.output.flush()?;
        let mut line = String::new();
        if self.input.read_line(&mut line)? == 0 {
            writeln!(self.output)?;
            bail!("the input ended before the last answer");
        }
        Ok(line.trim().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn talk(lines: &str, columns: usize) -> (Result<Answers>, String) {
        let mut output = Vec::new();
        let answers = Dialogue::new(&mut lines.as_bytes(), &mut output, Some(columns))
            .ask_all(&Found::default());
        (answers, String::from_utf8(output).unwrap())
    }

    #[test]
    fn enter_accepts_every_default() {
        let (answers, text) = talk(&"\n".repeat(15), 80);
        let answers = answers.unwrap();
        assert_eq!(answers.text("camera"), Some("/dev/video0"));
        assert_eq!(answers.numbers("wheels_m"), [0.05, 0.24]);
        assert!(text.contains("[0.05 0.24]:") && !text.contains('!'), "{text}");
    }

    #[test]
    fn a_wrong_answer_is_explained_and_asked_again() {
        let (answers, text) = talk(&format!("\n99 0\n0.3 0.1\n{}", "\n".repeat(13)), 80);
        assert_eq!(answers.unwrap().numbers("camera_place_m"), [0.3, 0.1]);
        assert!(text.contains("!  99 is not allowed: it must be 0.05 to 3.0 m"), "{text}");
    }

    #[test]
    fn an_input_that_ends_is_an_error() {
        let error = talk("\n\n", 80).0.unwrap_err().to_string();
        assert!(error.contains("ended before the last answer"), "{error}");
    }

    #[test]
    fn no_line_is_wider_than_the_terminal() {
        for columns in [40, 60, 100] {
            let (_, text) = talk(&"\n".repeat(20), columns);
            assert!(text.lines().all(|line| line.chars().count() <= columns + 1), "{text}");
        }
    }
}
