//! Checks across processes, and of the house itself.

mod altered;
mod architecture;
mod bad_input;
mod budgets;
mod configuration;
mod crash;
mod doctor;
mod dose;
mod endure;
mod faults;
mod film;
mod hostile;
mod instruments;
mod logging;
mod modules;
mod outputs;
mod packaging;
mod picture_stream;
mod pictures;
mod play;
mod record_replay;
mod shortage;
mod sleep;
mod streams;
mod text;
mod watch;
