"""Pages, figures and tables of logs, studies and tuning."""
