%
( reversal test: X 0 -> 180 -> 0 mm, 8 equal moves each way; 36 mm/s is 10 counts per tick )
O 180;
N 10 G01 F 2160;
N 15 G91;
N 20 X 22.5;
N 25 X 22.5;
N 30 X 22.5;
N 35 X 22.5;
N 40 X 22.5;
N 45 X 22.5;
N 50 X 22.5;
N 55 X 22.5;
N 60 X -22.5;
N 65 X -22.5;
N 70 X -22.5;
N 75 X -22.5;
N 80 X -22.5;
N 85 X -22.5;
N 90 X -22.5;
N 95 X -22.5;
N 100 M30;
%
