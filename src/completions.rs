//! `headtail completions`: shell completion scripts.

use anyhow::Result;
use clap::{Args, CommandFactory};
use clap_complete::{Shell, generate};

use crate::terminal::out;

/// Print a script that completes commands and options in a shell.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail completions bash > ~/.local/share/bash-completion/completions/headtail
  headtail completions zsh > ~/.zfunc/_headtail
  headtail completions fish > ~/.config/fish/completions/headtail.fish")]
pub struct Arguments {
    /// Shell: bash, zsh, fish, elvish or powershell.
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Prints the script.
pub fn run<C: CommandFactory>(arguments: &Arguments) -> Result<()> {
    let mut script = Vec::new();
    generate(arguments.shell, &mut C::command(), "headtail", &mut script);
    out!("{}", String::from_utf8(script)?.trim_end());
    Ok(())
}
