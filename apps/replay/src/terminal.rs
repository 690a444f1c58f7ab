//! A terminal that gives single keys and shows one line that changes.

use anyhow::{Context, bail};
use crossterm::cursor::MoveToColumn;
use crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers, poll, read};
use crossterm::terminal::{Clear, ClearType, disable_raw_mode, enable_raw_mode, size};
use crossterm::{execute, style::Print};
use protocol::inputs::Key;
use std::io::{IsTerminal, stderr, stdin};
use std::time::Duration;

/// Columns where a terminal does not say how many it has.
const COLUMNS: usize = 80;

/// The terminal, which gives keys as they are pressed until this is dropped.
pub struct Terminal {
    shown: String,
}

/// What a person did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pressed {
    /// A key with a name.
    Key(Key),
    /// Ctrl-C, which is no signal here.
    Interrupt,
}

impl Terminal {
    /// Takes the terminal over.
    ///
    /// # Errors
    /// Where standard input or standard error is no terminal.
    pub fn open() -> anyhow::Result<Self> {
        if !stdin().is_terminal() || !stderr().is_terminal() {
            bail!("--interactive needs a terminal: standard input and standard error must be one");
        }
        enable_raw_mode().context("the terminal")?;
        Ok(Terminal { shown: String::new() })
    }

    /// The next key; waits for it for at most `wait`.
    ///
    /// # Errors
    /// Where the terminal cannot be read.
    pub fn next(&mut self, wait: Duration) -> anyhow::Result<Option<Pressed>> {
        if !poll(wait).context("the terminal")? {
            return Ok(None);
        }
        Ok(match read().context("the terminal")? {
            Event::Key(event) if event.kind == KeyEventKind::Press => pressed(event),
            _ => None,
        })
    }

    /// Shows a line in the place of the one before.
    ///
    /// # Errors
    /// Where the terminal cannot be written.
    pub fn show(&mut self, line: &str) -> anyhow::Result<()> {
        // Some terminals say that they have none.
        let columns = size().map_or(0, |(columns, _)| usize::from(columns));
        let columns = if columns == 0 { COLUMNS } else { columns };
        let line: String = line.chars().take(columns.saturating_sub(1)).collect();
        if line != self.shown {
            execute!(stderr(), MoveToColumn(0), Clear(ClearType::CurrentLine), Print(&line))
                .context("the terminal")?;
            self.shown = line;
        }
        Ok(())
    }

    /// Writes lines above that line.
    ///
    /// # Errors
    /// Where the terminal cannot be written.
    pub fn print(&mut self, text: &str) -> anyhow::Result<()> {
        execute!(stderr(), MoveToColumn(0), Clear(ClearType::CurrentLine)).context("the terminal")?;
        for line in text.lines() {
            execute!(stderr(), Print(line), Print("\r\n")).context("the terminal")?;
        }
        self.shown.clear();
        Ok(())
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = execute!(stderr(), Print("\r\n"));
        let _ = disable_raw_mode();
    }
}

fn pressed(event: KeyEvent) -> Option<Pressed> {
    let control = event.modifiers.contains(KeyModifiers::CONTROL);
    if control {
        return (event.code == KeyCode::Char('c')).then_some(Pressed::Interrupt);
    }
    Key::named(&name_of(event.code)?).map(Pressed::Key)
}

/// The key's name for `protocol::inputs`.
fn name_of(code: KeyCode) -> Option<String> {
    let name = match code {
        KeyCode::Char(' ') => "space",
        KeyCode::Char(',') => "comma",
        KeyCode::Char('.') => "period",
        KeyCode::Char('+') => "plus",
        KeyCode::Char('-') => "minus",
        KeyCode::Char(letter) => return Some(letter.to_ascii_lowercase().to_string()),
        KeyCode::F(number) => return Some(format!("f{number}")),
        KeyCode::Left => "left",
        KeyCode::Right => "right",
        KeyCode::Up => "up",
        KeyCode::Down => "down",
        KeyCode::Home => "home",
        KeyCode::End => "end",
        KeyCode::PageUp => "page-up",
        KeyCode::PageDown => "page-down",
        KeyCode::Enter => "enter",
        KeyCode::Esc => "escape",
        KeyCode::Backspace => "backspace",
        KeyCode::Tab => "tab",
        _ => return None,
    };
    Some(name.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::transport::MOVES;

    #[test]
    fn every_move_has_a_key_that_a_terminal_gives() {
        let codes = (' '..='~').map(KeyCode::Char).chain((1..=12).map(KeyCode::F)).chain([
            KeyCode::Left,
            KeyCode::Right,
            KeyCode::Up,
            KeyCode::Down,
            KeyCode::Home,
            KeyCode::End,
            KeyCode::PageUp,
            KeyCode::PageDown,
            KeyCode::Enter,
            KeyCode::Esc,
            KeyCode::Backspace,
        ]);
        let given: Vec<String> = codes.filter_map(name_of).collect();
        for (what, keys, _) in MOVES {
            assert!(keys.iter().all(|key| given.iter().any(|name| name == key)), "{what:?}");
        }
    }

    #[test]
    fn control_c_ends_and_other_control_keys_mean_nothing() {
        let with = |letter, modifiers| pressed(KeyEvent::new(KeyCode::Char(letter), modifiers));
        assert_eq!(with('c', KeyModifiers::CONTROL), Some(Pressed::Interrupt));
        assert_eq!(with('q', KeyModifiers::CONTROL), None);
        assert_eq!(with('Q', KeyModifiers::SHIFT), Key::named("q").map(Pressed::Key));
        assert_eq!(with('ä', KeyModifiers::NONE), None);
    }
}
