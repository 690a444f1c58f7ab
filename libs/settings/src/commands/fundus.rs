//! Options of the fundus photograph.

use std::path::PathBuf;

/// The chosen photograph.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct FundusArgs {
    /// Fundus photograph for the retina [default: the shipped one]: a square JPEG or PNG whose sides touch the round
    /// image of the fundus.
    #[arg(long, value_name = "PHOTO", help_heading = "Fundus and instruments")]
    pub fundus: Option<PathBuf>,
    /// Eye in the photograph: left or right [default: left].
    #[arg(
        long,
        value_name = "SIDE",
        hide_possible_values = true,
        requires = "fundus",
        help_heading = "Fundus and instruments"
    )]
    pub fundus_eye: Option<FundusEye>,
    /// Position of the fovea, as fractions of width and height from the upper left [default: the centre].
    #[arg(long, value_name = "X,Y", value_parser = shares, requires = "fundus", help_heading = "Fundus and instruments")]
    pub fundus_fovea: Option<[f32; 2]>,
    /// Field of view of the fundus camera, degrees [default: 45].
    #[arg(long, value_name = "DEG", value_parser = degrees, allow_negative_numbers = true, requires = "fundus", help_heading = "Fundus and instruments")]
    pub fundus_field: Option<f32>,
}

/// The eye in a photograph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum FundusEye {
    /// The patient's left one.
    Left,
    /// The patient's right one.
    Right,
}

impl FundusArgs {
    /// The options as arguments of another program of this build.
    pub fn arguments(&self) -> Vec<String> {
        let eye = self.fundus_eye.map(|eye| if eye == FundusEye::Left { "left" } else { "right" });
        let named = [
            ("--fundus", self.fundus.as_ref().map(|photograph| photograph.display().to_string())),
            ("--fundus-eye", eye.map(Into::into)),
            ("--fundus-fovea", self.fundus_fovea.map(|[x, y]| format!("{x},{y}"))),
            ("--fundus-field", self.fundus_field.map(|degrees| degrees.to_string())),
        ];
        let given = named.into_iter().filter_map(|(name, value)| Some([name.to_owned(), value?]));
        given.flatten().collect()
    }
}

fn shares(text: &str) -> Result<[f32; 2], String> {
    let share = |t: &str| t.trim().parse().ok().filter(|s| (0.0..=1.0).contains(s));
    let both = text.split_once(',').and_then(|(x, y)| Some([share(x)?, share(y)?]));
    both.ok_or_else(|| "expected two fractions from 0 to 1, such as 0.62,0.5".into())
}

fn degrees(text: &str) -> Result<f32, String> {
    let value = text.parse().ok().filter(|d| (10.0..=60.0).contains(d));
    value.ok_or_else(|| "expected 10 to 60 degrees".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        fundus: FundusArgs,
    }

    #[test]
    fn what_is_given_reaches_the_other_program_and_nonsense_is_refused() {
        let parse = |words: &[&str]| Line::try_parse_from(std::iter::once(&"x").chain(words));
        let given = ["--fundus", "a.jpg", "--fundus-eye", "right", "--fundus-fovea", "0.6,0.5"];
        let all = [&given[..], &["--fundus-field", "50"]].concat();
        assert_eq!(parse(&all).unwrap().fundus.arguments(), all);
        assert!(parse(&[]).unwrap().fundus.arguments().is_empty());
        for wrong in [
            &["--fundus-eye", "right"][..],
            &["--fundus", "a", "--fundus-eye", "both"],
            &["--fundus", "a", "--fundus-fovea", "0.6"],
            &["--fundus", "a", "--fundus-fovea", "6,0.5"],
            &["--fundus", "a", "--fundus-field", "180"],
        ] {
            assert!(parse(wrong).is_err(), "{wrong:?} was taken");
        }
    }
}
